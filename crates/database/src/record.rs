//! A record of the index: the pose, the quality and the stored bytes of one image. It takes 80 bytes, little-endian.

use glam::{DQuat, DVec3};

use realitysim_geometry::{Isometry, Physical};
use realitysim_views::TagError;

/// One image of the index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// Position of `camera_link` in `map`, metres.
    pub place: [f32; 3],
    /// Rotation of `camera_link` in `map`, unit quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// Number of the source in the contents.
    pub source: u32,
    /// Number of the file in its source.
    pub file: u32,
    /// Where the image's bytes begin in the file.
    pub offset: u64,
    /// Number of the image's bytes.
    pub length: u32,
    /// CRC-32 of the image's bytes, by which a change after indexing is noticed.
    pub crc: u32,
    /// Time of exposure, nanoseconds; 0 for an image of a folder.
    pub stamp_ns: i64,
    /// Standard deviation of the position, metres; 0 if unknown.
    pub sigma_m: f32,
    /// Standard deviation of the rotation, radians; 0 if unknown.
    pub sigma_rad: f32,
    /// Mean absolute second difference of green over its mean; higher is sharper.
    pub sharpness: f32,
    /// Mean of green, 0 to 255.
    pub brightness: f32,
    /// What the bytes are.
    pub form: Form,
}

/// The form of an image's stored bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A JPEG or PNG file.
    File,
    /// A `sensor_msgs/Image` in CDR.
    RosImage,
}

/// Size of a record in the index.
pub(super) const RECORD_BYTES: usize = 80;

/// The accuracy assumed for poses that state none, as if measured carefully by hand.
const ASSUMED: TagError = TagError { position_m: 0.01, rotation_rad: 0.25 * core::f64::consts::PI / 180.0 };

impl Physical for Record {
    fn is_possible(&self) -> bool {
        let length = self.rotation.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
        // A tag cannot be off by more in any hall. 0 stands for an unknown accuracy.
        let sigmas = [self.sigma_m, self.sigma_rad].iter().all(|sigma| (0.0..=1000.0).contains(sigma));
        sigmas && self.place.iter().all(|metres| f64::from(*metres).is_possible()) && (0.99..1.01).contains(&length)
    }
}

impl Record {
    /// A record with a pose of `camera_link` in `map` and no image.
    pub fn at(pose: &Isometry) -> Self {
        let mut record = Self {
            place: [0.0; 3],
            rotation: [0.0; 4],
            source: 0,
            file: 0,
            offset: 0,
            length: 0,
            crc: 0,
            stamp_ns: 0,
            sigma_m: 0.0,
            sigma_rad: 0.0,
            sharpness: 0.0,
            brightness: 0.0,
            form: Form::File,
        };
        record.set_pose(pose);
        record
    }

    /// The pose of `camera_link` in `map`.
    pub fn pose(&self) -> Isometry {
        let [x, y, z] = self.place.map(f64::from);
        let [qx, qy, qz, qw] = self.rotation.map(f64::from);
        Isometry::new(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(x, y, z))
    }

    /// The accuracy of the pose, or an assumed one if the pose states none.
    pub fn tag(&self) -> TagError {
        match self.says_how_good_it_is() {
            true => TagError { position_m: f64::from(self.sigma_m), rotation_rad: f64::from(self.sigma_rad) },
            false => ASSUMED,
        }
    }

    /// Whether the pose states its accuracy.
    pub fn says_how_good_it_is(&self) -> bool {
        self.sigma_m > 0.0 || self.sigma_rad > 0.0
    }

    pub(super) fn set_pose(&mut self, pose: &Isometry) {
        self.place = pose.translation.as_vec3().to_array();
        let q = pose.rotation;
        self.rotation = [q.x, q.y, q.z, q.w].map(|x| x as f32);
    }

    pub(super) fn to_bytes(self) -> [u8; RECORD_BYTES] {
        let mut bytes = [0; RECORD_BYTES];
        let mut at = 0;
        let mut put = |part: &[u8]| {
            bytes[at..at + part.len()].copy_from_slice(part);
            at += part.len();
        };
        self.place.iter().chain(&self.rotation).for_each(|x| put(&x.to_le_bytes()));
        put(&self.source.to_le_bytes());
        put(&self.file.to_le_bytes());
        put(&self.length.to_le_bytes());
        put(&self.offset.to_le_bytes());
        put(&self.stamp_ns.to_le_bytes());
        [self.sigma_m, self.sigma_rad, self.sharpness, self.brightness].iter().for_each(|x| put(&x.to_le_bytes()));
        put(&self.crc.to_le_bytes());
        put(&u32::from(self.form == Form::RosImage).to_le_bytes());
        bytes
    }

    /// Reads a record. Any bytes are a record; impossible values are noticed where they are used.
    pub(super) fn from_bytes(bytes: &[u8; RECORD_BYTES]) -> Self {
        let word = |at: usize| -> [u8; 4] { core::array::from_fn(|i| bytes[at + i]) };
        let long = |at: usize| -> [u8; 8] { core::array::from_fn(|i| bytes[at + i]) };
        let float = |at: usize| f32::from_le_bytes(word(at));
        let whole = |at: usize| u32::from_le_bytes(word(at));
        Self {
            place: core::array::from_fn(|i| float(4 * i)),
            rotation: core::array::from_fn(|i| float(12 + 4 * i)),
            source: whole(28),
            file: whole(32),
            length: whole(36),
            offset: u64::from_le_bytes(long(40)),
            stamp_ns: i64::from_le_bytes(long(48)),
            sigma_m: float(56),
            sigma_rad: float(60),
            sharpness: float(64),
            brightness: float(68),
            crc: whole(72),
            form: if whole(76) == 1 { Form::RosImage } else { Form::File },
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use realitysim_geometry::Euler;

    pub(crate) fn record_at(x: f64, y: f64, z: f64, yaw: f64) -> Record {
        let euler = Euler { yaw, pitch: 0.5, roll: 0.01 };
        Record {
            source: 1,
            file: 2,
            offset: 1 << 40,
            length: 4,
            crc: 5,
            stamp_ns: -6,
            sigma_m: 0.007,
            sigma_rad: 0.008,
            sharpness: 9.0,
            brightness: 10.0,
            form: Form::RosImage,
            ..Record::at(&Isometry::from_euler(euler, DVec3::new(x, y, z)))
        }
    }

    #[test]
    fn a_record_survives_its_bytes() {
        let record = record_at(1.0, -2.0, 0.5, 3.0);
        assert_eq!(Record::from_bytes(&record.to_bytes()), record);
        let far = Record { form: Form::File, ..record };
        assert_eq!(Record::from_bytes(&far.to_bytes()), far);
    }
}
