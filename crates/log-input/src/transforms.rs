//! The tree of transforms of `/tf` and `/tf_static`, and the chain through it from the robot's footprint to its camera.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::history::{History, Pushed};
use realitysim_config::FrameNames;
use realitysim_geometry::physical::MAX_MOUNT_M;
use realitysim_geometry::{Euler, Isometry, Physical};

/// The transforms between coordinate frames, constant ones and the recent past of moving ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformTree {
    /// Edge to the parent, by the name of the child frame: each frame has one parent.
    edges: BTreeMap<String, Edge>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Edge {
    parent: String,
    transform: Transform,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
enum Transform {
    Static(Isometry),
    Moving(History<Isometry>),
}

/// Measurements that replace parts of the chain which the log has as constants.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Posture {
    /// Attitude of `base_link` against gravity; its yaw is ignored.
    pub attitude: Option<DQuat>,
    /// Angles of the head's joints.
    pub head: Option<Head>,
}

/// Angles of the head's joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Head {
    /// Angle about the torso's z axis, radians, positive to the left.
    pub pan: f64,
    /// Angle about the panned head's y axis, radians, positive downwards.
    pub tilt: f64,
}

/// The pose of the camera above `base_footprint`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPlace {
    /// Pose of `camera_link` in `base_footprint`, metres.
    pub footprint_from_link: Isometry,
    /// Pose of `camera_optical_frame` in `base_footprint`, metres.
    pub footprint_from_optical: Isometry,
    /// Pose of `camera_optical_frame` in `base_link`, the torso's coordinate frame, metres.
    pub base_from_optical: Isometry,
    /// Age of the oldest moving transform that was used, nanoseconds.
    pub age_ns: i64,
    /// Whether the tilt of the torso is measured: by its attitude, or by a moving transform on the way to it.
    pub tilt_is_measured: bool,
    /// Angle between the torso's axis and the vertical, radians, where the tilt is measured.
    pub lean_rad: Option<f64>,
}

/// Why the transforms do not give the pose of the camera.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ChainError {
    /// A transform of the chain is missing.
    #[error(
        "no transform leads to {frame}: /tf_static (or /tf) must connect {from} to {to}, but the chain ends at {frame}"
    )]
    Broken {
        /// The coordinate frame without a parent.
        frame: String,
        /// The coordinate frame at which the chain should begin.
        from: String,
        /// The coordinate frame at which the chain ends.
        to: String,
    },
    /// The chain is longer than any real one: it is a circle.
    #[error("the transforms run in a circle at {frame}")]
    Circle {
        /// A coordinate frame in the circle.
        frame: String,
    },
    /// The camera stands on the ground or below it.
    #[error(
        "the camera is {height_m:.3} m above the ground: the mount in /tf_static is zero or missing a translation \
         ({base} to {camera} must give the camera's height)"
    )]
    NoHeight {
        /// Height of the camera above the ground, metres.
        height_m: f64,
        /// Name of the coordinate frame on the ground.
        base: String,
        /// Name of the camera's coordinate frame.
        camera: String,
    },
    /// A transform is not finite or too long.
    #[error(
        "the transform to {frame} holds a number that is not finite, or leads more than {MAX_MOUNT_M} m away: /tf_static must \
         give its place in metres"
    )]
    Impossible {
        /// The child coordinate frame of the transform.
        frame: String,
    },
    /// The camera looks up more steeply than 80 degrees.
    #[error(
        "{optical} does not look forward but {elevation_deg:.0} deg up: the rotation from {link} to {optical} is \
         missing (REP 103: z forward, x right, y down)"
    )]
    LooksUp {
        /// Name of the optical coordinate frame.
        optical: String,
        /// Name of the camera's coordinate frame.
        link: String,
        /// Angle of the optical axis above the horizon, degrees.
        elevation_deg: f64,
    },
}

/// Smallest height of a camera above the ground, metres. Below it the mount is missing.
const MIN_HEIGHT_M: f64 = 0.02;
/// Largest number of transforms in a chain. A longer one is a circle.
const MAX_LINKS: usize = 64;
/// Largest number of coordinate frames, more than any robot has. Further ones are left out.
const MAX_FRAMES: usize = 4096;

impl TransformTree {
    /// Sets a constant transform.
    pub fn set_static(&mut self, parent: &str, child: &str, parent_from_child: Isometry) {
        self.insert(parent, child, Transform::Static(parent_from_child));
    }

    /// Adds a sample of a moving transform; where the frame had a constant one or another parent, that is replaced.
    pub fn push(&mut self, stamp_ns: i64, parent: &str, child: &str, parent_from_child: Isometry) -> Pushed {
        match self.edges.get_mut(child) {
            Some(Edge { parent: known, transform: Transform::Moving(history) }) if known == parent => {
                history.push(stamp_ns, parent_from_child)
            }
            _ => {
                let mut history = History::default();
                let pushed = history.push(stamp_ns, parent_from_child);
                self.insert(parent, child, Transform::Moving(history));
                pushed
            }
        }
    }

    /// Returns whether there is no transform.
    pub fn is_empty(&self) -> bool {
        self.edges.is_empty()
    }

    /// Returns whether every moving transform is [`Physical`]. Constants are checked where they are used.
    pub fn is_possible(&self) -> bool {
        self.edges.values().all(|edge| match &edge.transform {
            Transform::Static(_) => true,
            Transform::Moving(history) => history.is_possible(),
        })
    }

    /// Returns whether a coordinate frame has a transform to a parent.
    pub fn knows(&self, frame: &str) -> bool {
        self.edges.contains_key(frame)
    }

    /// Returns the rotation `a_from_b` between two coordinate frames, or the identity if constants do not connect them.
    pub fn fixed_rotation(&self, a: &str, b: &str) -> DQuat {
        match (self.root_from(a), self.root_from(b)) {
            (Some((root_a, from_a)), Some((root_b, from_b))) if root_a == root_b => from_a.conjugate() * from_b,
            _ => DQuat::IDENTITY,
        }
    }

    /// Returns the farthest ancestor that constants lead to, and the rotation from there; `None` in a circle.
    fn root_from(&self, frame: &str) -> Option<(String, DQuat)> {
        let (mut here, mut rotation) = (frame.to_owned(), DQuat::IDENTITY);
        for _ in 0..MAX_LINKS {
            match self.edges.get(&here) {
                Some(Edge { parent, transform: Transform::Static(constant) }) => {
                    rotation = constant.rotation * rotation;
                    here = parent.clone();
                }
                _ => return Some((here, rotation)),
            }
        }
        None
    }

    /// Returns whether every moving transform of the chain is known up to `stamp_ns`; true where there is no chain.
    pub fn is_known_until(&self, stamp_ns: i64, names: &FrameNames) -> bool {
        self.chain(&names.base_footprint, &names.camera_optical).map_or(true, |chain| {
            chain.iter().all(|link| match &link.edge.transform {
                Transform::Static(_) => true,
                Transform::Moving(history) => history.settled_ns().is_some_and(|settled| settled >= stamp_ns),
            })
        })
    }

    /// Returns the pose of the camera at a time.
    ///
    /// Where `/tf` moves the torso or head, its transforms are used. Where these are constants, `posture` fills in the
    /// attitude of `base_link` and the angles of the head.
    pub fn camera_place(&self, stamp_ns: i64, names: &FrameNames, posture: Posture) -> Result<CameraPlace, ChainError> {
        let mut age_ns = 0;
        let mut footprint_from_here = Isometry::IDENTITY;
        let mut footprint_from_link = None;
        let mut footprint_from_base = Isometry::IDENTITY;
        let (mut tilt_is_measured, mut below_torso, mut lean_rad) = (false, false, None);
        for Link { frame: child, edge, is_upwards } in self.chain(&names.base_footprint, &names.camera_optical)? {
            let step = match &edge.transform {
                Transform::Moving(history) => {
                    tilt_is_measured |= !below_torso;
                    let sample = history
                        .at(stamp_ns)
                        .unwrap_or(super::history::Sample { value: Isometry::IDENTITY, age_ns: i64::MAX });
                    age_ns = age_ns.max(sample.age_ns);
                    if is_upwards { sample.value.inverse() } else { sample.value }
                }
                Transform::Static(constant) if is_upwards && child == names.base_link => {
                    tilt_is_measured |= posture.attitude.is_some();
                    with_attitude(constant.inverse(), posture.attitude)
                }
                Transform::Static(constant) if is_upwards => constant.inverse(),
                Transform::Static(constant) if child == names.base_link => {
                    tilt_is_measured |= posture.attitude.is_some();
                    with_attitude(*constant, posture.attitude)
                }
                Transform::Static(constant) if child == names.camera_link && edge.parent != names.base_footprint => {
                    with_head(*constant, posture.head)
                }
                Transform::Static(constant) => *constant,
            };
            footprint_from_here = footprint_from_here * step;
            if !is_mount(&step) || !is_mount(&footprint_from_here) {
                return Err(ChainError::Impossible { frame: child.to_owned() });
            }
            if child == names.base_link {
                below_torso = true;
                footprint_from_base = footprint_from_here;
                lean_rad =
                    tilt_is_measured.then(|| libm::acos((footprint_from_here.rotation * DVec3::Z).z.clamp(-1.0, 1.0)));
            }
            if child == names.camera_link {
                footprint_from_link = Some(footprint_from_here);
            }
        }
        let footprint_from_optical = footprint_from_here;
        let footprint_from_link =
            footprint_from_link.unwrap_or_else(|| footprint_from_optical * Isometry::link_from_optical().inverse());
        let base_from_optical = footprint_from_base.inverse() * footprint_from_optical;
        Ok(CameraPlace {
            footprint_from_link,
            footprint_from_optical,
            base_from_optical,
            age_ns,
            tilt_is_measured,
            lean_rad,
        })
    }

    /// Checks that the mount can be right: the camera stands above the ground and does not look up steeply.
    pub fn check_mount(&self, stamp_ns: i64, names: &FrameNames) -> Result<(), ChainError> {
        let place = self.camera_place(stamp_ns, names, Posture::default())?.footprint_from_optical;
        let height_m = place.translation.z;
        if height_m.is_nan() || height_m < MIN_HEIGHT_M {
            let (base, camera) = (names.base_footprint.clone(), names.camera_link.clone());
            return Err(ChainError::NoHeight { height_m, base, camera });
        }
        let elevation = libm::asin(place.transform_vector(DVec3::Z).z.clamp(-1.0, 1.0));
        if elevation > 80f64.to_radians() {
            let (optical, link) = (names.camera_optical.clone(), names.camera_link.clone());
            return Err(ChainError::LooksUp { optical, link, elevation_deg: elevation.to_degrees() });
        }
        Ok(())
    }

    /// Checks that the chain can be right.
    ///
    /// A chain that moves, or that `/tf` may still complete (`more_may_come`), passes here; it is checked at each frame.
    pub fn check_constants(&self, names: &FrameNames, more_may_come: bool) -> Result<(), ChainError> {
        let chain = match self.chain(&names.base_footprint, &names.camera_optical) {
            Err(ChainError::Broken { .. }) if more_may_come => return Ok(()),
            chain => chain?,
        };
        let mut moving = false;
        for Link { frame, edge, .. } in chain {
            match &edge.transform {
                Transform::Static(constant) if !is_mount(constant) => {
                    return Err(ChainError::Impossible { frame: frame.to_owned() });
                }
                Transform::Static(_) => {}
                Transform::Moving(_) => moving = true,
            }
        }
        if moving { Ok(()) } else { self.check_mount(0, names) }
    }

    /// Stores an edge, unless there are too many coordinate frames.
    fn insert(&mut self, parent: &str, child: &str, transform: Transform) {
        if self.edges.len() < MAX_FRAMES || self.edges.contains_key(child) {
            self.edges.insert(child.to_owned(), Edge { parent: parent.to_owned(), transform });
        }
    }

    /// Returns the links that lead from `from` to `to`: down the tree, or first up to a common ancestor and then down.
    ///
    /// REP 105 has the torso below the footprint; robots that follow REP 120 send the footprint as a child of the torso.
    fn chain<'a>(&'a self, from: &'a str, to: &'a str) -> Result<Vec<Link<'a>>, ChainError> {
        let (mut down, root) = self.ancestors(to, from)?;
        let mut chain = Vec::new();
        if root != from {
            let is_above = |frame: &str| frame == to || down.iter().any(|(_, edge)| edge.parent == frame);
            let mut here = from;
            while !is_above(here) {
                let Some(edge) = self.edges.get(here) else {
                    let (from, to) = (from.to_owned(), to.to_owned());
                    return Err(ChainError::Broken { frame: root.to_owned(), from, to });
                };
                if chain.len() >= MAX_LINKS {
                    return Err(ChainError::Circle { frame: here.to_owned() });
                }
                chain.push(Link { frame: &edge.parent, edge, is_upwards: true });
                here = &edge.parent;
            }
            let below = down.iter().position(|(child, _)| *child == here).unwrap_or(down.len());
            down.truncate(below);
        }
        chain.extend(down.into_iter().rev().map(|(frame, edge)| Link { frame, edge, is_upwards: false }));
        Ok(chain)
    }

    /// Returns the edges from `frame` upwards, and the frame at which they end: `top`, or one without a parent.
    fn ancestors<'a>(&'a self, frame: &'a str, top: &str) -> Result<(Vec<NamedEdge<'a>>, &'a str), ChainError> {
        let mut edges = Vec::new();
        let mut here = frame;
        while here != top {
            let Some((child, edge)) = self.edges.get_key_value(here) else { break };
            if edges.len() >= MAX_LINKS {
                return Err(ChainError::Circle { frame: here.to_owned() });
            }
            edges.push((child.as_str(), edge));
            here = &edge.parent;
        }
        Ok((edges, here))
    }

    /// Returns the pose of the footprint in the torso's coordinate frame at a time, if it is a child of the torso.
    pub fn base_from_footprint(&self, stamp_ns: i64, names: &FrameNames) -> Option<Isometry> {
        let edge = self.edges.get(&names.base_footprint).filter(|edge| edge.parent == names.base_link)?;
        match &edge.transform {
            Transform::Static(constant) => Some(*constant),
            Transform::Moving(history) => history.at(stamp_ns).map(|sample| sample.value),
        }
        .filter(is_mount)
    }

    /// Returns whether constants alone connect two coordinate frames, so that one is mounted on the other.
    pub fn is_mounted_on(&self, a: &str, b: &str) -> bool {
        a == b
            || matches!((self.root_from(a), self.root_from(b)),
                (Some((root_a, _)), Some((root_b, _))) if root_a == root_b)
    }
}

/// An edge with the name of its child frame.
type NamedEdge<'a> = (&'a str, &'a Edge);

/// A step of a chain from one coordinate frame to the next.
struct Link<'a> {
    /// The coordinate frame that the step leads to.
    frame: &'a str,
    /// The edge that it goes along.
    edge: &'a Edge,
    /// Whether it goes from child to parent, against the direction of the transform.
    is_upwards: bool,
}

/// Returns whether a part of a robot can be mounted on another part like this: finite, and at most 100 m away.
fn is_mount(transform: &Isometry) -> bool {
    transform.is_possible() && transform.translation.length() <= MAX_MOUNT_M
}

/// Tilts the torso as the IMU says: roll and pitch replace those of the constant, yaw stays.
fn with_attitude(constant: Isometry, attitude: Option<DQuat>) -> Isometry {
    let Some(attitude) = attitude else { return constant };
    let tilt = Euler::from_rotation(attitude);
    let yaw = constant.euler().yaw;
    Isometry::from_euler(Euler { yaw, ..tilt }, constant.translation)
}

/// Turns the camera with a head that pans about the torso's z axis and then tilts about its own y axis.
fn with_head(constant: Isometry, head: Option<Head>) -> Isometry {
    let Some(head) = head else { return constant };
    let turn = Euler { yaw: head.pan, pitch: head.tilt, roll: 0.0 }.rotation();
    Isometry::new(turn * constant.rotation, constant.translation)
}

#[cfg(test)]
mod tests;
