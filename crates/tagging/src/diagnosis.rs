//! Finds out why frames could not be placed on the field.
//!
//! A few of the frames are located again, each alone, by a survey ([`ImagePrior::locate_by_survey`]), with other fields, other lenses and
//! other mounts. Nothing is assumed about how the robot moved.

use std::borrow::Cow;

use super::image_location::{FitQuality, PoseHypothesis};
use super::parallel::in_parallel;
use super::perception_pool::decode_picture;
use super::setup::FramePerception;
use super::single_image::{ImagePrior, MEASURED_HEIGHT_SIGMA_M, searched_m2};
use realitysim_config::{Settings, Topics, field_names, lens_names, load_field_of_size, load_lens};
use realitysim_geometry::{Euler, Field, FieldDimensions, Isometry, Lens, LensParameters};
use realitysim_log_input::synchroniser::Frame;
use realitysim_log_input::transforms::Head;
use realitysim_ros2::mcap_read::LogMessage;

/// Samples of the frames whose images could be used but not placed, spread evenly over a recording of any length.
#[derive(Debug, Default)]
pub struct UnplacedFrames {
    frames: Vec<Sample>,
    /// Number of frames so far.
    count: u64,
    /// One of this many frames is kept. It doubles each time that the samples are full.
    every: u64,
}

#[derive(Debug)]
struct Sample {
    message: LogMessage,
    footprint_from_link: Isometry,
    head: Option<Head>,
}

/// Number of samples kept: enough to tell a cause from chance, few enough to be searched often.
const SAMPLES: usize = 6;

/// Fewest samples for a diagnosis. Some frames are always unplaced, because a pose needs several frames to be confirmed.
const MIN_SAMPLES: usize = 3;

impl UnplacedFrames {
    /// Takes an unplaced frame into account. Frames whose camera has no known place on the robot are ignored.
    pub fn note(&mut self, frame: &Frame) {
        let Ok(place) = &frame.robot.place else { return };
        let every = self.every.max(1);
        if self.count.is_multiple_of(every) {
            if self.frames.len() >= SAMPLES {
                let mut index = 0;
                self.frames.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.every = 2 * every;
            }
            self.frames.push(Sample {
                message: frame.message.clone(),
                footprint_from_link: place.footprint_from_link,
                head: frame.robot.head,
            });
        }
        self.count += 1;
    }
}

/// The configuration that the frames were tagged with.
pub struct DiagnosisInput<'a> {
    /// The settings.
    pub settings: &'a Settings,
    /// The topics, which the text names.
    pub topics: &'a Topics,
    /// The field.
    pub field: &'a Field,
    /// Vision, lens and body masks.
    pub perception: &'a FramePerception,
    /// Number of threads to use.
    pub threads: usize,
}

/// One deviation from the configuration that is tried.
#[derive(Clone, Debug, PartialEq)]
enum Change {
    Nothing,
    Field(String),
    /// The name of a shipped lens.
    Lens(String),
    /// Factor of the focal length.
    Focal(f64),
    /// Additional pitch of the camera, degrees; positive is down.
    Pitch(f64),
    /// Additional roll of the camera, degrees.
    Roll(f64),
    /// Factor of the camera's height above the carpet.
    Height(f64),
}

/// How well the samples fit with one change.
#[derive(Clone, Debug, PartialEq)]
struct Tried {
    change: Change,
    /// Number of samples in which some pose explains the lines.
    fits: usize,
    /// Number of these in which no other pose does so nearly as well.
    clear: usize,
    /// Sum over all samples of the log likelihood, if that is above 0, times the shares of line places that fit and of seen lines that
    /// are explained.
    ///
    /// Where lines are seen wider or farther away, by another field or from another height, the log likelihood of a wrong pose grows
    /// as well. The shares make such changes comparable.
    explained: f64,
}

/// How well a sample fits with one change.
struct Located {
    fit: FitQuality,
    explained: f64,
}

/// Ratio of [`Tried::explained`], changed to unchanged, from which a change is named as the cause. Measured on
/// rendered and path-traced walks: the right configuration explains 2 to 56 times as much as a wrong field, 2.7 times as a focal
/// length that is a quarter off, 2.3 to 3.3 times as a height that is 10 cm off, 20 times as a mount that is 10 degrees off.
const CLEAR_RATIO: f64 = 1.5;
/// Ratio up to which the configuration is not doubted, if most samples fit clearly with it. One of a hundred changes
/// explains a little more by chance.
const DOUBT_RATIO: f64 = 1.25;
/// Share of what the best field explains from which another field is named with it.
const NEAR_SHARE: f64 = 0.9;
/// Step between pitches that are tried. All steps are so fine that more than half of what the right value explains is left
/// between two of them.
const PITCH_DEG: f64 = 2.0;
/// Number of pitches tried to each side.
const PITCH_STEPS: i32 = 8;
/// Step between rolls that are tried.
const ROLL_DEG: f64 = 2.5;
/// Number of rolls tried to each side.
const ROLL_STEPS: i32 = 4;
/// The roll of a camera that is mounted upside down.
const UPSIDE_DOWN_DEG: f64 = 180.0;
/// Ratio between neighbouring focal lengths and heights that are tried.
const SCALE_RATIO: f64 = 1.07;
/// Standard deviation of the tilt in each trial.
const TILT_SIGMA_RAD: f64 = 0.005;
/// Number of focal lengths and heights tried to each side.
const SCALE_STEPS: i32 = 5;
/// Number of fields, of lenses and of mounts, the best by a few samples, that are tried with all samples.
const FINALISTS: usize = 3;
/// Largest area of carpet that a diagnosis searches, all its searches together, square metres.
///
/// The number of searches is bounded by the steps above and by the shipped fields and lenses, and a search takes as long as
/// its field is large: 8 million poses of the survey's grid in all at most. Fields of up to 9 x 6 m need no more; on larger ones fewer samples are searched.
const MAX_SEARCHED_M2: f64 = 17_000.0;
/// Numbers of samples for a whole diagnosis and for its first rounds, the best that fits into [`MAX_SEARCHED_M2`].
const SAMPLE_COUNTS: [[usize; 2]; 4] = [[SAMPLES, 2], [SAMPLES, 1], [4, 1], [MIN_SAMPLES, 1]];

impl DiagnosisInput<'_> {
    /// The most probable cause in one or two sentences, or `None` if there are too few frames to tell, or the field is too
    /// large to be searched often enough.
    ///
    /// Its work is bounded by the area that it searches: [`MAX_SEARCHED_M2`].
    pub fn cause(&self, unplaced: &UnplacedFrames) -> Option<String> {
        let is_other =
            |name: &String| self.other_field(name).is_some_and(|field| !field.is_same_as(self.field.dimensions()));
        let others: Vec<Change> = field_names().into_iter().filter(is_other).map(Change::Field).collect();
        let (lenses, mounts) = (self.lenses(), mounts());
        let [most, few] = self.sample_counts(&others, lenses.len() + mounts.len())?;
        let all = spread(&unplaced.frames, most);
        if all.len() < MIN_SAMPLES {
            return None;
        }
        let few: Vec<&Sample> = spread(&all, few).into_iter().copied().collect();
        let finals_of = |changes: Vec<Change>| {
            let mut tried = self.try_changes(&changes, &few);
            sort(&mut tried);
            let finalists: Vec<Change> = tried.into_iter().take(FINALISTS).map(|tried| tried.change).collect();
            let mut tried = self.try_changes(&finalists, &all);
            sort(&mut tried);
            tried
        };
        let own = self.try_changes(&[Change::Nothing], &all).remove(0);
        let fields = finals_of(others);
        let best_of = |changes| finals_of(changes).into_iter().next();
        let (lens, mount) = (best_of(lenses), best_of(mounts));
        let found: Vec<Tried> = [fields.first().cloned(), lens, mount].into_iter().flatten().collect();
        Some(self.describe(&own, &found, &fields, all.len()))
    }

    /// The diagnosis as text. `own` is the unchanged configuration, `found` the best change of each kind, `fields` the best fields.
    fn describe(&self, own: &Tried, found: &[Tried], fields: &[Tried], frames: usize) -> String {
        let looked_at = format!("of {frames} of these frames, each looked at alone,");
        let best = found.iter().max_by(|a, b| a.explained.total_cmp(&b.explained));
        let hurried = match self.settings.filter.budget_ms {
            0.0 => String::new(),
            budget_ms => format!(", or filter.budget_ms = {budget_ms} is too small for a search of the field"),
        };
        match best {
            Some(best @ Tried { change: Change::Field(_), .. }) if is_clear(best, own, frames) => {
                self.describe_field(best, fields, own, frames)
            }
            Some(best) if is_clear(best, own, frames) => format!(
                "most probably {} wrong: {looked_at} {} if {}, and {} as it was said, which explains {:.1} times less",
                best.change.part(),
                fit(best.fits),
                best.change,
                own.fits,
                ratio(best, own)
            ),
            best if 2 * own.clear >= frames && !best.is_some_and(|best| explains_more(best, own, DOUBT_RATIO)) => {
                format!(
                    "most probably neither field, lens nor mount is wrong: {looked_at} {} as they were said. What remains is how the \
                 robot moved, by {} and {}, and when{hurried}",
                    fit(own.clear),
                    self.topics.odometry,
                    self.topics.imu,
                )
            }
            // No lines were found under any assumption: nothing can be said about field, lens or mount.
            _ if own.fits == 0 && found.iter().all(|tried| tried.fits == 0) => format!(
                "the pictures show no lines of a field, or too faintly: {looked_at} none has a place on any field, through any lens or from \
                 any mount that was tried, whose lines lie there more often than by chance{hurried}"
            ),
            _ => {
                let each = found.iter().map(|tried| format!("{} ({})", tried.change, fit(tried.fits)));
                let each: Vec<String> = each.collect();
                format!(
                    "no single cause was found{hurried}: {looked_at} {} field, lens and mount as they were said. Of other fields, \
                     lenses and mounts, these explain most, and not clearly more: {}",
                    fit(own.fits),
                    each.join(", ")
                )
            }
        }
    }

    /// The text for a wrong field, with the other fields that explain nearly as much.
    fn describe_field(&self, best: &Tried, fields: &[Tried], own: &Tried, frames: usize) -> String {
        let near = |tried: &&Tried| tried.explained > NEAR_SHARE * best.explained && fits_mostly(tried, frames);
        let names = fields.iter().filter(near).filter_map(|tried| match &tried.change {
            Change::Field(name) => Some(name.as_str()),
            _ => None,
        });
        let names: Vec<&str> = names.collect();
        let [name, others @ ..] = names.as_slice() else { return String::new() };
        let others = if others.is_empty() { String::new() } else { format!(" ({} nearly as well)", others.join(", ")) };
        format!(
            "most probably it is another field: of {frames} of these frames, each looked at alone, {} {name}{others}, and {} {}, \
             which explains {:.1} times less: try --field {name}",
            fit(best.fits),
            own.fits,
            self.settings.field,
            ratio(best, own)
        )
    }

    /// Numbers of samples for the whole diagnosis and for its first rounds, or `None` if no number fits into
    /// [`MAX_SEARCHED_M2`]. `others` are the other fields, `changes` counts lenses and mounts.
    fn sample_counts(&self, others: &[Change], changes: usize) -> Option<[usize; 2]> {
        let area_m2 = |change: &Change| self.field_of(change).map_or(0.0, |field| searched_m2(&field));
        let own_m2 = searched_m2(self.field);
        let others_m2: Vec<f64> = others.iter().map(area_m2).collect();
        let largest_m2 = others_m2.iter().copied().fold(0.0, f64::max);
        let finalists = FINALISTS as f64;
        let finals_m2 = (1.0 + 2.0 * finalists) * own_m2 + finalists * largest_m2;
        let first_m2 = changes as f64 * own_m2 + others_m2.iter().sum::<f64>();
        let fits = |[most, few]: &[usize; 2]| *most as f64 * finals_m2 + *few as f64 * first_m2 <= MAX_SEARCHED_M2;
        SAMPLE_COUNTS.into_iter().find(fits)
    }

    /// Tries each change with the samples; the results are in the order of `changes`.
    fn try_changes(&self, changes: &[Change], samples: &[&Sample]) -> Vec<Tried> {
        let found = in_parallel(self.threads, changes.len() * samples.len(), |index| {
            self.locate(&changes[index / samples.len()], samples[index % samples.len()])
        });
        let of = |(change, found): (&Change, &[Option<Located>])| {
            let found = found.iter().flatten();
            let count = |is: fn(FitQuality) -> bool| found.clone().filter(|located| is(located.fit)).count();
            Tried {
                change: change.clone(),
                fits: count(|fit| fit != FitQuality::None),
                clear: count(|fit| fit == FitQuality::Good),
                explained: found.map(|located| located.explained).sum(),
            }
        };
        changes.iter().zip(found.chunks(samples.len().max(1))).map(of).collect()
    }

    /// Locates one sample with one change.
    ///
    /// `None` if the image or the field cannot be read, or no pose is found.
    fn locate(&self, change: &Change, sample: &Sample) -> Option<Located> {
        let given = self.perception.vision.lens();
        let lens = match change {
            Change::Lens(name) => load_lens(name).ok()?.lens,
            Change::Focal(times) => {
                let own = given.parameters();
                Lens::new(LensParameters { fx: own.fx * times, fy: own.fy * times, ..own.clone() }).ok()?
            }
            _ => given.clone(),
        };
        let Euler { pitch, roll, .. } = sample.footprint_from_link.euler();
        let height_m = sample.footprint_from_link.translation.z;
        let (pitch, roll, height_m) = match change {
            Change::Pitch(more) => (pitch + more.to_radians(), roll, height_m),
            Change::Roll(more) => (pitch, roll + more.to_radians(), height_m),
            Change::Height(times) => (pitch, roll, height_m * times),
            _ => (pitch, roll, height_m),
        };
        let field = self.field_of(change)?;
        let picture = decode_picture(&sample.message, &lens).ok()?;
        let body = self.perception.body(sample.head).cloned();
        let attitude = Euler { yaw: 0.0, pitch, roll };
        let (tilt_sigma_rad, height_sigma_m) = (TILT_SIGMA_RAD, MEASURED_HEIGHT_SIGMA_M);
        let known = ImagePrior { lens, attitude, tilt_sigma_rad, height_m, height_sigma_m, initial: None, body };
        let look = known.look_once(&picture, field.line_width());
        let located = known.locate_by_survey(&look, &field, self.settings.filter.seed);
        let PoseHypothesis { log_likelihood, explained, lines, .. } = *located.found.first()?;
        let explained = log_likelihood.max(0.0) * lines.share * explained;
        Some(Located { fit: located.fit(), explained })
    }

    /// The field with a change; `None` if it cannot be read.
    fn field_of(&self, change: &Change) -> Option<Cow<'_, Field>> {
        match change {
            Change::Field(name) => Some(Cow::Owned(Field::new(self.other_field(name)?).ok()?)),
            _ => Some(Cow::Borrowed(self.field)),
        }
    }

    /// A shipped field, of the measured size if the settings have one; `None` if its areas do not fit into that.
    fn other_field(&self, name: &str) -> Option<FieldDimensions> {
        load_field_of_size(name, self.settings.field_size_m).ok()
    }

    /// The changes of the lens that are tried: the shipped lenses with as many pixels, and other focal lengths.
    fn lenses(&self) -> Vec<Change> {
        let own = self.perception.vision.lens();
        let is_possible = |name: &String| {
            load_lens(name).is_ok_and(|file| {
                let lens = file.lens.parameters();
                (lens.width, lens.height) == (own.width(), own.height()) && !lens.maps_as(own.parameters())
            })
        };
        let shipped = lens_names().into_iter().filter(is_possible).map(Change::Lens);
        shipped.chain(scales().map(Change::Focal)).collect()
    }
}

/// The changes of the mount that are tried: pitch, roll and height.
fn mounts() -> Vec<Change> {
    let degrees =
        |most: i32, each: f64| (-most..=most).filter(|step| *step != 0).map(move |step| each * f64::from(step));
    let pitches = degrees(PITCH_STEPS, PITCH_DEG).map(Change::Pitch);
    let rolls = degrees(ROLL_STEPS, ROLL_DEG).chain([UPSIDE_DOWN_DEG]).map(Change::Roll);
    pitches.chain(rolls).chain(scales().map(Change::Height)).collect()
}

/// At most `count` of the items, spread evenly: of two, those at a quarter and at three quarters.
fn spread<T>(items: &[T], count: usize) -> Vec<&T> {
    let count = count.min(items.len());
    (0..count).map(|index| &items[(2 * index + 1) * items.len() / (2 * count)]).collect()
}

/// The factors of focal length and height that are tried.
fn scales() -> impl Iterator<Item = f64> {
    (-SCALE_STEPS..=SCALE_STEPS).filter(|step| *step != 0).map(|step| libm::pow(SCALE_RATIO, f64::from(step)))
}

/// Sorts by what is explained, most first.
fn sort(tried: &mut [Tried]) {
    tried.sort_by(|a, b| b.explained.total_cmp(&a.explained));
}

/// Whether a change explains so much more than the configuration that it is named as the cause.
fn is_clear(tried: &Tried, own: &Tried, frames: usize) -> bool {
    fits_mostly(tried, frames) && explains_more(tried, own, CLEAR_RATIO)
}

fn fits_mostly(tried: &Tried, frames: usize) -> bool {
    2 * tried.fits >= frames && tried.fits > 0
}

fn explains_more(tried: &Tried, own: &Tried, times: f64) -> bool {
    tried.explained > times * own.explained
}

/// How many times as much a change explains as the configuration, for texts: bounded, because that may be nothing.
fn ratio(tried: &Tried, own: &Tried) -> f64 {
    (tried.explained / own.explained.max(1e-9)).min(99.0)
}

fn fit(count: usize) -> String {
    if count == 1 { "1 fits".to_owned() } else { format!("{count} fit") }
}

impl Change {
    /// The part of the configuration that is changed, as the subject of a sentence.
    fn part(&self) -> &'static str {
        match self {
            Self::Nothing | Self::Field(_) => "the field (field = ...) is",
            Self::Lens(_) | Self::Focal(_) => "the lens (camera_info, or --lens) is",
            Self::Pitch(_) | Self::Roll(_) | Self::Height(_) => {
                "the mount of the camera (/tf_static, or [mount]) or of the IMU is"
            }
        }
    }
}

impl core::fmt::Display for Change {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Nothing => f.write_str("all is as it was said"),
            Self::Field(name) => write!(f, "the field is {name}"),
            Self::Lens(name) => write!(f, "the lens is {name}"),
            Self::Focal(times) => write!(f, "the focal length is {times:.2} times as long"),
            Self::Pitch(more) if *more < 0.0 => write!(f, "the camera looks {} deg farther up", -more),
            Self::Pitch(more) => write!(f, "the camera looks {more} deg farther down"),
            Self::Roll(more) if *more == UPSIDE_DOWN_DEG => f.write_str("the camera is upside down"),
            Self::Roll(more) => write!(f, "the camera is rolled by {more:+} deg"),
            Self::Height(times) => write!(f, "the camera is {times:.2} times as high above the carpet"),
        }
    }
}
