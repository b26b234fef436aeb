//! One image of the index: where its bytes are, where its camera was, how good it is. 80 bytes, little-endian.

use glam::{DQuat, DVec3};

use realitysim_geometry::{Isometry, Physical};
use realitysim_views::TagError;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    /// `camera_link` in `map`: metres, unit quaternion x, y, z, w.
    pub place: [f32; 3],
    pub rotation: [f32; 4],
    /// Of the catalogue's sources, and of that source's files.
    pub source: u32,
    pub file: u32,
    /// Where in the file its bytes begin, and how many there are.
    pub offset: u64,
    pub length: u32,
    /// CRC-32 of these bytes: what changed after indexing is noticed.
    pub crc: u32,
    pub stamp_ns: i64,
    /// Standard deviations of the tag; 0 where nobody said.
    pub sigma_m: f32,
    pub sigma_rad: f32,
    /// Mean absolute second difference of luma over its mean: higher is sharper.
    pub sharpness: f32,
    /// Mean luma, 0 to 255.
    pub brightness: f32,
    pub form: Form,
}

/// What the bytes are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A JPEG or PNG.
    File,
    /// A `sensor_msgs/Image` in CDR.
    RosImage,
}

pub(super) const RECORD_BYTES: usize = 80;

/// What poses that nobody knows the accuracy of are taken to be: measured with care, by hand.
const ASSUMED: TagError = TagError { position_m: 0.01, rotation_rad: 0.25 * core::f64::consts::PI / 180.0 };

impl Physical for Record {
    fn is_possible(&self) -> bool {
        let length = self.rotation.iter().map(|part| f64::from(*part).powi(2)).sum::<f64>().sqrt();
        // As far as a tag can be off in any hall; 0 is said of poses whose accuracy nobody knows.
        let sigmas = [self.sigma_m, self.sigma_rad].iter().all(|sigma| (0.0..=1000.0).contains(sigma));
        sigmas && self.place.iter().all(|metres| f64::from(*metres).is_possible()) && (0.99..1.01).contains(&length)
    }
}

impl Record {
    /// Of no image yet.
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

    pub fn pose(&self) -> Isometry {
        let [x, y, z] = self.place.map(f64::from);
        let [qx, qy, qz, qw] = self.rotation.map(f64::from);
        Isometry::new(DQuat::from_xyzw(qx, qy, qz, qw), DVec3::new(x, y, z))
    }

    /// Of images whose poses come without their accuracy: what is assumed.
    pub fn tag(&self) -> TagError {
        match self.says_how_good_it_is() {
            true => TagError { position_m: f64::from(self.sigma_m), rotation_rad: f64::from(self.sigma_rad) },
            false => ASSUMED,
        }
    }

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

    /// Any bytes are a record; what makes no sense is noticed where it is used.
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
