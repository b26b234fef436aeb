//! The route as a pure function of time. It consists of pieces of constant velocity: straight lines, arcs and turns on the spot.

use core::f64::consts::PI;

use glam::DVec2;

use super::file::{Route, Still, Walk};
use realitysim_geometry::{Pose2, wrap_angle};

/// The motion of the robot along its route.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Motion {
    pieces: Vec<Piece>,
    /// Seconds.
    duration: f64,
    /// False if the robot is carried from pose to pose.
    walks: bool,
}

/// A part of the route with constant speed and turn rate.
#[derive(Clone, Debug, PartialEq)]
struct Piece {
    /// Start of the piece, seconds since the start of the scene.
    start: f64,
    duration: f64,
    /// Pose at the start of the piece. The yaw is not wrapped, so that it counts turns.
    from: Pose2,
    /// Metres per second, forwards.
    speed: f64,
    /// Radians per second, to the left.
    turn: f64,
    /// Metres walked before this piece.
    walked: f64,
}

/// Pose and motion of `base_footprint` at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Travel {
    pub(super) map_from_base_footprint: Pose2,
    /// Pose since the start as odometry without any error measures it.
    pub(super) start_from_base_footprint: Pose2,
    /// Angle turned since the start, radians, not wrapped.
    pub(super) turned: f64,
    /// Distance walked since the start, metres.
    pub(super) walked: f64,
    /// Forward speed, m/s.
    pub(super) speed: f64,
    /// Turn rate to the left, rad/s.
    pub(super) turn: f64,
}

impl Motion {
    pub(super) fn new(route: &Route) -> Self {
        match route {
            Route::Walk(walk) => walking_motion(walk),
            Route::Still(still) => standing_motion(still),
        }
    }

    pub(super) fn duration(&self) -> f64 {
        self.duration
    }

    /// The times at which a walk stands at a waypoint: begin and end, seconds since the start, and the pose of `base_footprint`.
    pub(super) fn stands(&self) -> impl Iterator<Item = (f64, f64, Pose2)> + '_ {
        let is_stand = |piece: &&Piece| self.walks && piece.speed == 0.0 && piece.turn == 0.0;
        let stand = |piece: &Piece| {
            let pose = Pose2 { yaw: wrap_angle(piece.from.yaw), ..piece.from };
            (piece.start, piece.start + piece.duration, pose)
        };
        self.pieces.iter().filter(is_stand).map(stand)
    }

    /// Position on the route at `time`, seconds. Before the start and after the end the robot stands.
    pub(super) fn at(&self, time: f64) -> Travel {
        let clamped = time.clamp(0.0, self.duration);
        let index = self.pieces.partition_point(|piece| piece.start <= clamped).saturating_sub(1);
        let Some((piece, first)) = self.pieces.get(index).zip(self.pieces.first()) else {
            return Travel::standing(Pose2::default());
        };
        let dt = (clamped - piece.start).min(piece.duration);
        let pose = piece.at(dt);
        if !self.walks {
            return Travel::standing(pose);
        }
        let moving = time >= 0.0 && time < self.duration;
        Travel {
            map_from_base_footprint: Pose2 { yaw: wrap_angle(pose.yaw), ..pose },
            start_from_base_footprint: first.from.inverse().compose(&pose),
            turned: pose.yaw - first.from.yaw,
            walked: piece.walked + piece.speed * dt,
            speed: if moving { piece.speed } else { 0.0 },
            turn: if moving { piece.turn } else { 0.0 },
        }
    }
}

impl Travel {
    fn standing(pose: Pose2) -> Self {
        Self {
            map_from_base_footprint: Pose2 { yaw: wrap_angle(pose.yaw), ..pose },
            start_from_base_footprint: Pose2::default(),
            turned: 0.0,
            walked: 0.0,
            speed: 0.0,
            turn: 0.0,
        }
    }
}

impl Piece {
    /// Pose `dt` seconds after the start of the piece.
    fn at(&self, dt: f64) -> Pose2 {
        let yaw = self.from.yaw + self.turn * dt;
        let (sin0, cos0) = libm::sincos(self.from.yaw);
        if self.turn == 0.0 {
            let distance = self.speed * dt;
            return Pose2::new(self.from.x + distance * cos0, self.from.y + distance * sin0, yaw);
        }
        let radius = self.speed / self.turn;
        let (sin1, cos1) = libm::sincos(yaw);
        Pose2::new(self.from.x + radius * (sin1 - sin0), self.from.y - radius * (cos1 - cos0), yaw)
    }
}

/// The motion of a route that stands at one pose after the other.
fn standing_motion(still: &Still) -> Motion {
    let pieces: Vec<Piece> = still
        .poses
        .iter()
        .enumerate()
        .map(|(index, [x, y, yaw_deg])| Piece {
            start: index as f64 * still.hold_s,
            duration: still.hold_s,
            from: Pose2::new(*x, *y, yaw_deg.to_radians()),
            speed: 0.0,
            turn: 0.0,
            walked: 0.0,
        })
        .collect();
    Motion { duration: pieces.len() as f64 * still.hold_s, pieces, walks: false }
}

/// The motion of a walk. A corner becomes the arc that the turn rate demands at full speed.
///
/// Where the legs are too short for that arc, the robot slows down to a tighter one, in the limit a turn on the spot.
/// The turn rate stays the same.
fn walking_motion(walk: &Walk) -> Motion {
    let points: Vec<DVec2> = walk.waypoints.iter().map(|point| DVec2::from(*point)).collect();
    let legs: Vec<DVec2> = points.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let headings: Vec<f64> = legs.iter().map(|leg| libm::atan2(leg.y, leg.x)).collect();
    let turn_rate = walk.turn_deg_s.to_radians();
    let first = headings.first().copied().unwrap_or(0.0);
    let start_yaw = walk.start_yaw_deg.map_or(first, f64::to_radians);
    let start = points.first().copied().unwrap_or(DVec2::ZERO);
    let mut builder = Builder::new(Pose2::new(start.x, start.y, start_yaw));
    builder.arc(wrap_angle(first - start_yaw), 0.0, turn_rate);
    // Length of the leg that the arc at its start replaces.
    let mut used = 0.0;
    for (index, leg) in legs.iter().enumerate() {
        let length = leg.length();
        let Some((next, heading)) = legs.get(index + 1).zip(headings.get(index + 1)) else {
            builder.straight(length - used, walk.speed_m_s);
            builder.stand(walk.stand_s);
            break;
        };
        let turn = wrap_angle(heading - headings[index]);
        if walk.stand_s > 0.0 {
            builder.straight(length, walk.speed_m_s);
            builder.stand(walk.stand_s);
            builder.arc(turn, 0.0, turn_rate);
            continue;
        }
        // At a reversal the tangent is (nearly) infinite and the radius (nearly) zero.
        let tangent = libm::tan(turn.abs().min(PI - 1e-9) / 2.0);
        let room = length.min(next.length()) / 2.0;
        let radius = (walk.speed_m_s / turn_rate).min(room / tangent.max(1e-12));
        let cut = radius * tangent;
        builder.straight(length - used - cut, walk.speed_m_s);
        builder.arc(turn, radius, turn_rate);
        used = cut;
    }
    Motion { duration: builder.time, pieces: builder.pieces, walks: true }
}

/// A route under construction, with time, pose and distance at its end.
struct Builder {
    pieces: Vec<Piece>,
    time: f64,
    pose: Pose2,
    walked: f64,
}

impl Builder {
    fn new(pose: Pose2) -> Self {
        Self { pieces: Vec::new(), time: 0.0, pose, walked: 0.0 }
    }

    /// Appends a straight line of `length` metres.
    fn straight(&mut self, length: f64, speed: f64) {
        if length > 1e-9 {
            self.push(length / speed, speed, 0.0);
        }
    }

    /// Appends a time in which nothing moves.
    fn stand(&mut self, seconds: f64) {
        if seconds > 0.0 {
            self.push(seconds, 0.0, 0.0);
        }
    }

    /// Appends an arc of `angle` radians (above 0 to the left) with `radius` metres.
    fn arc(&mut self, angle: f64, radius: f64, turn_rate: f64) {
        if angle.abs() > 1e-9 {
            self.push(angle.abs() / turn_rate, radius * turn_rate, turn_rate.copysign(angle));
        }
    }

    fn push(&mut self, duration: f64, speed: f64, turn: f64) {
        let piece = Piece { start: self.time, duration, from: self.pose, speed, turn, walked: self.walked };
        self.time += duration;
        self.pose = piece.at(duration);
        self.walked += speed * duration;
        self.pieces.push(piece);
    }
}
