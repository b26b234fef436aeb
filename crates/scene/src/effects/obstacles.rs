//! Robots and people on and around the field. They hide lines, and their shells and clothes can look like lines.

use core::ops::RangeInclusive;

use glam::DVec2;
use serde::Deserialize;

use super::{EffectKind, Role};
use crate::Scene;
use crate::SceneError;
use crate::check::{check_range, refuse};
use crate::stream::{Purpose, Stream};
use realitysim_geometry::{Field, Pose2};

/// Figures on and around the field.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Obstacles {
    /// Why the scene has this effect, for people.
    pub role: Option<Role>,
    /// Figures that the file describes.
    #[serde(default)]
    pub figures: Vec<Figure>,
    /// Number of further robots and people that are drawn from the seed. They keep clear of the robot's path.
    #[serde(default)]
    pub random: i64,
}

/// A figure that stands at `position_m` or walks along `path`, to its end and back again and again.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figure {
    /// Shape of the figure.
    pub shape: FigureShape,
    /// Position [x, y] of a standing figure in `map`, metres.
    pub position_m: Option<[f64; 2]>,
    /// Yaw of a standing figure in `map`, degrees. Without it the figure faces the centre of the field.
    pub yaw_deg: Option<f64>,
    /// Two or more points [x, y] in `map`, metres, that a walking figure follows.
    pub path: Option<Vec<[f64; 2]>>,
    /// Speed of a walking figure, m/s.
    pub speed_m_s: Option<f64>,
    /// Height, metres. The default is 1.75 m for a person, 0.14 m for a ball and 0.6 m for other shapes.
    pub height_m: Option<f64>,
    /// Width over the shoulders, metres. The default depends on shape and height: a cylinder or box has 0.3 m, a ball its height.
    pub width_m: Option<f64>,
    /// Red, green and blue (0 to 255) of the shell, the shirt or the whole body.
    pub colour: Option<[f64; 3]>,
    /// Red, green and blue (0 to 255) of the jersey of a robot or the trousers of a person.
    pub accent: Option<[f64; 3]>,
}

/// The shape of a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FigureShape {
    /// A humanoid robot.
    Robot,
    /// A person.
    Person,
    /// An upright cylinder.
    Cylinder,
    /// An upright box.
    Box,
    /// A ball that lies on the ground. Its height is its diameter.
    Ball,
}

/// All figures of a scene, with defaults filled in.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Crowd {
    pub(crate) members: Vec<Member>,
}

/// A figure with defaults filled in. Lengths are metres.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Member {
    pub(crate) shape: FigureShape,
    pub(crate) height: f64,
    pub(crate) width: f64,
    pub(crate) colour: [f64; 3],
    pub(crate) accent: [f64; 3],
    course: Course,
}

/// Where a figure stands, or how it walks.
#[derive(Clone, Debug, PartialEq)]
enum Course {
    Standing(Pose2),
    Walking { points: Vec<DVec2>, speed: f64 },
}

/// The pose of a figure at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Standpoint {
    pub(crate) pose: Pose2,
    /// Distance walked, metres, if the figure walks.
    pub(crate) walked: Option<f64>,
}

/// Maximum number of figures: as many as a match has on and around its field. Each costs time in every frame.
const MAX_FIGURES: usize = 48;
/// Maximum distance of a figure from the carpet, metres. Farther out it would stand in the wall of the hall.
const MAX_ASIDE_M: f64 = 5.0;

const DARK: [f64; 3] = [44.0, 44.0, 48.0];
const BALL: [f64; 3] = [226.0, 224.0, 218.0];
const SHIRT: [f64; 3] = [70.0, 84.0, 112.0];
const TROUSERS: [f64; 3] = [48.0, 48.0, 58.0];

impl EffectKind for Obstacles {
    fn role(&self) -> Option<Role> {
        self.role
    }

    fn check(&self, key: &str, field: &Field) -> Result<(), SceneError> {
        let most = MAX_FIGURES as f64;
        check_range(format_args!("{key}.random"), self.random as f64, 0.0..=most, &format!("0 to {MAX_FIGURES}"))?;
        let count = self.figures.len() + self.random as usize;
        if !(1..=MAX_FIGURES).contains(&count) {
            let expected = format!("figures and random add up to 1 to {MAX_FIGURES}");
            return Err(refuse(format_args!("{key}.figures"), format_args!("{count} in all"), expected));
        }
        let check = |(index, figure): (usize, &Figure)| figure.check(&format!("{key}.figures[{index}]"), field);
        self.figures.iter().enumerate().try_for_each(check)
    }

    fn add_to(&self, scene: &mut Scene, _: &str) -> Result<(), SceneError> {
        scene.crowd = Some(self.model(scene.file.scene.seed, &scene.field, &scene.sampled_path()));
        Ok(())
    }
}

impl Obstacles {
    /// The figures of the scene. Random figures keep clear of `robot_path`, points in `map`.
    pub(crate) fn model(&self, seed: u64, field: &Field, robot_path: &[DVec2]) -> Crowd {
        let mut members: Vec<Member> = self.figures.iter().map(Figure::member).collect();
        for index in 0..self.random as u64 {
            let mut stream = Stream::new(seed, Purpose::Obstacles, index);
            let member = random_figure(&mut stream, field, robot_path, &members);
            members.push(member);
        }
        Crowd { members }
    }
}

impl Figure {
    fn check(&self, key: &str, field: &Field) -> Result<(), SceneError> {
        let course = match (&self.position_m, &self.path) {
            (Some(_), Some(_)) => Some("both position_m and path"),
            (None, None) => Some("neither position_m nor path"),
            _ => None,
        };
        if let Some(found) = course {
            return Err(refuse(key, found, "one of them: position_m to stand, path and speed_m_s to walk"));
        }
        for point in self.position_m.iter().chain(self.path.iter().flatten()) {
            check_in_hall(key, *point, field)?;
        }
        match (&self.path, self.speed_m_s) {
            (None, Some(speed)) => {
                return Err(refuse(format_args!("{key}.speed_m_s"), speed, "only a figure with a path walks"));
            }
            (Some(_), None) => return Err(refuse(format_args!("{key}.speed_m_s"), "absent", "a path needs a speed")),
            (Some(path), Some(speed)) => {
                check_range(format_args!("{key}.speed_m_s"), speed, 0.01..=5.0, "0.01 to 5 m/s")?;
                if path.len() < 2 || length(path) < 0.01 {
                    let expected = "two or more points, 0.01 m or more from end to end";
                    return Err(refuse(format_args!("{key}.path"), format_args!("{path:?}"), expected));
                }
            }
            (None, None) => {}
        }
        if let Some(yaw) = self.yaw_deg {
            check_range(format_args!("{key}.yaw_deg"), yaw, -360.0..=360.0, "-360 to 360 degrees")?;
        }
        let size = |name: &str, value: Option<f64>, range: RangeInclusive<f64>, expected: &str| {
            value.map_or(Ok(()), |value| check_range(format_args!("{key}.{name}"), value, range, expected))
        };
        size("height_m", self.height_m, 0.1..=2.5, "0.1 to 2.5 m")?;
        size("width_m", self.width_m, 0.05..=1.5, "0.05 to 1.5 m")?;
        for (name, colour) in [("colour", self.colour), ("accent", self.accent)] {
            for value in colour.into_iter().flatten() {
                check_range(format_args!("{key}.{name}"), value, 0.0..=255.0, "red, green and blue of 0 to 255")?;
            }
        }
        Ok(())
    }

    /// The figure with defaults filled in.
    fn member(&self) -> Member {
        let points = || self.path.iter().flatten().map(|point| DVec2::from(*point)).collect();
        let course = match self.position_m {
            Some([x, y]) => {
                let yaw = self.yaw_deg.map_or(libm::atan2(-y, -x), f64::to_radians);
                Course::Standing(Pose2::new(x, y, yaw))
            }
            None => Course::Walking { points: points(), speed: self.speed_m_s.unwrap_or(0.0) },
        };
        let (height, colour, accent) = match self.shape {
            FigureShape::Person => (1.75, SHIRT, TROUSERS),
            FigureShape::Ball => (0.14, BALL, BALL),
            _ => (0.6, DARK, self.colour.unwrap_or(DARK)),
        };
        let height = self.height_m.unwrap_or(height);
        Member {
            shape: self.shape,
            height,
            width: self.width_m.unwrap_or_else(|| default_width(self.shape, height)),
            colour: self.colour.unwrap_or(colour),
            accent: self.accent.unwrap_or(accent),
            course,
        }
    }
}

impl Member {
    /// Pose of the figure at `time`, seconds since the start of the scene.
    pub(crate) fn at(&self, time: f64) -> Standpoint {
        match &self.course {
            Course::Standing(pose) => Standpoint { pose: *pose, walked: None },
            Course::Walking { points, speed } => {
                let walked = speed * time.max(0.0);
                Standpoint { pose: pose_on_path(points, walked), walked: Some(walked) }
            }
        }
    }
}

fn default_width(shape: FigureShape, height: f64) -> f64 {
    match shape {
        FigureShape::Robot => 0.46 * height,
        FigureShape::Person => 0.26 * height,
        FigureShape::Cylinder | FigureShape::Box => 0.3,
        FigureShape::Ball => height,
    }
}

fn length(path: &[[f64; 2]]) -> f64 {
    path.windows(2).map(|pair| DVec2::from(pair[0]).distance(DVec2::from(pair[1]))).sum()
}

/// Checks that a figure at `point` does not stand in the wall of the hall.
fn check_in_hall(key: &str, point: [f64; 2], field: &Field) -> Result<(), SceneError> {
    let limit = field.carpet_half_extent() + DVec2::splat(MAX_ASIDE_M);
    if DVec2::from(point).abs().cmple(limit).all() {
        return Ok(());
    }
    let expected = format!("a place at most {} m in x and {} m in y from the centre of this field", limit.x, limit.y);
    Err(refuse(key, format_args!("{point:?}"), expected))
}

/// Pose of a figure that has walked `walked` metres along the points and back, facing ahead.
fn pose_on_path(points: &[DVec2], walked: f64) -> Pose2 {
    let length: f64 = points.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let lap = walked % (2.0 * length);
    let back = lap > length;
    let mut left = if back { 2.0 * length - lap } else { lap };
    let mut pose = Pose2::default();
    for pair in points.windows(2) {
        let leg = pair[1] - pair[0];
        let leg_length = leg.length();
        if leg_length == 0.0 {
            continue;
        }
        let place = pair[0] + leg * (left / leg_length).min(1.0);
        let ahead = if back { -leg } else { leg };
        pose = Pose2::new(place.x, place.y, libm::atan2(ahead.y, ahead.x));
        if left <= leg_length {
            break;
        }
        left -= leg_length;
    }
    pose
}

const SHELLS: [[f64; 3]; 4] = [DARK, [206.0, 208.0, 210.0], [124.0, 126.0, 130.0], [58.0, 58.0, 62.0]];
const JERSEYS: [[f64; 3]; 4] = [[172.0, 44.0, 44.0], [44.0, 66.0, 164.0], [190.0, 120.0, 40.0], [30.0, 30.0, 34.0]];
const SHIRTS: [[f64; 3]; 5] =
    [SHIRT, [60.0, 60.0, 66.0], [188.0, 186.0, 180.0], [140.0, 54.0, 50.0], [96.0, 104.0, 96.0]];

/// Minimum distance of a random figure from the path of the robot, metres.
const MIN_DISTANCE_TO_PATH_M: f64 = 0.6;
/// Minimum distance of a random figure from the start of every other figure, metres.
const MIN_DISTANCE_TO_FIGURES_M: f64 = 0.5;
/// Maximum number of positions tried for a random figure. If none is free, the figure stands beside the carpet.
const MAX_DRAWS: usize = 200;
/// Distance from the carpet of figures for which the field has no room, metres.
const BESIDE_M: f64 = 0.8;

/// Draws a robot or a person that stands or walks.
fn random_figure(stream: &mut Stream, field: &Field, robot_path: &[DVec2], others: &[Member]) -> Member {
    let pick =
        |stream: &mut Stream, from: &[[f64; 3]]| from[(stream.uniform() * from.len() as f64) as usize % from.len()];
    let is_robot = stream.uniform() < 0.6;
    let (shape, height, colour, accent) = if is_robot {
        let (shell, jersey) = (pick(stream, &SHELLS), pick(stream, &JERSEYS));
        (FigureShape::Robot, stream.between(0.5, 0.95), shell, jersey)
    } else {
        let shirt = pick(stream, &SHIRTS);
        (FigureShape::Person, stream.between(1.62, 1.9), shirt, TROUSERS)
    };
    let walks = stream.uniform() < 0.5;
    let speed = if is_robot { stream.between(0.12, 0.35) } else { stream.between(0.3, 0.9) };
    let half = field.carpet_half_extent();
    let place = |stream: &mut Stream| DVec2::new(stream.between(-half.x, half.x), stream.between(-half.y, half.y));
    let mut ends = [DVec2::new(stream.between(-half.x, half.x), half.y + BESIDE_M); 2];
    for _ in 0..MAX_DRAWS {
        let first = place(stream);
        let second = if walks { place(stream) } else { first };
        let clear = |point: &DVec2, reach: f64| distance_to_leg([first, second], *point) > reach;
        let stand = |other: &Member| DVec2::new(other.at(0.0).pose.x, other.at(0.0).pose.y);
        if robot_path.iter().all(|point| clear(point, MIN_DISTANCE_TO_PATH_M))
            && others.iter().all(|other| clear(&stand(other), MIN_DISTANCE_TO_FIGURES_M))
        {
            ends = [first, second];
            break;
        }
    }
    let course = if walks && ends[0].distance(ends[1]) > 0.1 {
        Course::Walking { points: ends.to_vec(), speed }
    } else {
        Course::Standing(Pose2::new(ends[0].x, ends[0].y, stream.between(-3.0, 3.0)))
    };
    Member { shape, height, width: default_width(shape, height), colour, accent, course }
}

/// Distance of a point from the segment `from` to `to`.
fn distance_to_leg([from, to]: [DVec2; 2], point: DVec2) -> f64 {
    let along = to - from;
    let share = ((point - from).dot(along) / along.length_squared().max(1e-12)).clamp(0.0, 1.0);
    point.distance(from + along * share)
}
