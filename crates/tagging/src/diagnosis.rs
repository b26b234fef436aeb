//! Why frames could not be placed on the field: some of them are looked at again, each alone as `realitysim tag` does it, with
//! other fields, other lenses and other mounts. Nothing is assumed of how the robot moved.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::perception_pool::view;
use super::setup::FramePerception;
use super::single_image::{FitQuality, ImagePrior};
use realitysim_config::{Settings, Topics, field_names, lens_names, load_field, load_lens};
use realitysim_geometry::{Euler, Field, Isometry, Lens, LensParameters};
use realitysim_log_input::synchroniser::Frame;
use realitysim_log_input::transforms::Head;
use realitysim_ros2::mcap_read::LogMessage;

/// Frames that were not placed though something was seen in them, spread evenly over a recording of any length.
#[derive(Debug, Default)]
pub struct UnplacedFrames {
    frames: Vec<Sample>,
    /// How many there have been.
    count: u64,
    /// Twofold each time that there is no room: of so many frames one is kept.
    every: u64,
}

#[derive(Debug)]
struct Sample {
    message: LogMessage,
    footprint_from_link: Isometry,
    head: Option<Head>,
}

/// Frames that are kept: enough to tell chance from cause, few enough to be searched for a hundred times.
const MOST: usize = 6;

/// Of fewer nothing is said: a pose needs some frames to be confirmed, whatever is right.
const FEWEST: usize = 3;

impl UnplacedFrames {
    pub fn note(&mut self, frame: &Frame) {
        let Ok(place) = &frame.robot.place else { return };
        let every = self.every.max(1);
        if self.count.is_multiple_of(every) {
            if self.frames.len() >= MOST {
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

/// What was said of the robot and its field.
pub struct DiagnosisInput<'a> {
    pub settings: &'a Settings,
    pub topics: &'a Topics,
    pub field: &'a Field,
    pub eyes: &'a FramePerception,
    /// To look with.
    pub threads: usize,
}

/// One thing that may be other than it was said to be.
#[derive(Clone, Debug, PartialEq)]
enum Change {
    Nothing,
    Field(String),
    /// A shipped one.
    Lens(String),
    /// The focal length by this factor.
    Focal(f64),
    /// Degrees farther down.
    Pitch(f64),
    /// Degrees.
    Roll(f64),
    /// The height above the carpet by this factor.
    Height(f64),
}

/// What frames say of it.
#[derive(Clone, Debug, PartialEq)]
struct Tried {
    change: Change,
    /// Frames in which some pose explains the lines.
    fits: usize,
    /// Of these, those in which no other pose does so nearly as well.
    clear: usize,
    /// Of all frames.
    log_likelihood: f64,
}

/// How much more than what was said something must explain to be told as the cause. Measured: what is right explains 1.7 to 2.4
/// times as much as a wrong field, a lens of another focal length or a mount that is off by more than three degrees.
const CLEARLY: f64 = 1.5;
/// While nothing explains so much more, and most frames fit nowhere else, what was said is not doubted. Of a hundred things that
/// are tried one explains a little more by chance.
const HARDLY: f64 = 1.25;
/// Fields that explain nearly as much as the best one are told with it.
const NEARLY: f64 = 0.9;
/// So fine that between two steps more than half of what the right value explains is left.
const PITCH_DEG: f64 = 2.0;
const PITCHES: i32 = 8;
const ROLL_DEG: f64 = 2.5;
const ROLLS: i32 = 4;
const UPSIDE_DOWN_DEG: f64 = 180.0;
const TIMES: f64 = 1.07;
/// Of an attitude that is tried.
const TILT_SIGMA_RAD: f64 = 0.005;
const SCALES: i32 = 5;
/// Of the lenses and mounts, those that explain most of two frames are tried with all.
const CLOSER: usize = 3;

impl DiagnosisInput<'_> {
    /// What is most probably wrong, in a sentence or two; `None` if there are too few frames to tell.
    pub fn cause(&self, unplaced: &UnplacedFrames) -> Option<String> {
        let all: Vec<&Sample> = unplaced.frames.iter().collect();
        if all.len() < FEWEST {
            return None;
        }
        let own = self.tried(&[Change::Nothing], &all).remove(0);
        let is_other = |name: &String| load_field(name).is_ok_and(|field| !field.is_same_as(self.field.dimensions()));
        let others = field_names().into_iter().filter(is_other).map(Change::Field);
        let mut fields = self.tried(&others.collect::<Vec<_>>(), &all);
        sort(&mut fields);
        let is_clear = |tried: &Tried| fits_mostly(tried, all.len()) && explains_more(tried, &own, CLEARLY);
        if let Some(best) = fields.first().filter(|best| is_clear(best)) {
            return Some(self.blames_field(best, &fields, &own, all.len()));
        }
        let two: Vec<&Sample> = [all.len() / 4, 3 * all.len() / 4].map(|index| all[index]).to_vec();
        let best_of = |changes: Vec<Change>| {
            let mut tried = self.tried(&changes, &two);
            sort(&mut tried);
            let closer: Vec<Change> = tried.into_iter().take(CLOSER).map(|tried| tried.change).collect();
            let mut tried = self.tried(&closer, &all);
            sort(&mut tried);
            tried.into_iter().next()
        };
        let (lens, mount) = (best_of(self.lenses()), best_of(mounts()));
        let found: Vec<Tried> = [fields.into_iter().next(), lens, mount].into_iter().flatten().collect();
        Some(self.told(&own, &found, all.len()))
    }

    fn told(&self, own: &Tried, found: &[Tried], frames: usize) -> String {
        let looked_at = format!("of {frames} of these frames, each looked at alone,");
        let best = found.iter().max_by(|a, b| a.log_likelihood.total_cmp(&b.log_likelihood));
        let hurried = match self.settings.filter.budget_ms {
            0.0 => String::new(),
            budget_ms => format!(", or filter.budget_ms = {budget_ms} is too small for a search of the field"),
        };
        match best {
            Some(best) if fits_mostly(best, frames) && explains_more(best, own, CLEARLY) => format!(
                "most probably {} wrong: {looked_at} {} if {}, and {} as it was said, which explains {:.1} times less",
                best.change.part(),
                fit(best.fits),
                best.change,
                own.fits,
                times_more(best, own)
            ),
            best if 2 * own.clear >= frames && !best.is_some_and(|best| explains_more(best, own, HARDLY)) => format!(
                "most probably neither field, lens nor mount is wrong: {looked_at} {} as they were said. What remains is how the \
                 robot moved, by {} and {}, and when{hurried}",
                fit(own.clear),
                self.topics.odometry,
                self.topics.imu,
            ),
            // Then nothing speaks of field, lens or mount.
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

    fn blames_field(&self, best: &Tried, fields: &[Tried], own: &Tried, frames: usize) -> String {
        let near = |tried: &&Tried| tried.log_likelihood > NEARLY * best.log_likelihood && fits_mostly(tried, frames);
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
            times_more(best, own)
        )
    }

    /// In the order of `changes`.
    fn tried(&self, changes: &[Change], samples: &[&Sample]) -> Vec<Tried> {
        let found = in_parallel(self.threads, changes.len() * samples.len(), |index| {
            self.look(&changes[index / samples.len()], samples[index % samples.len()])
        });
        let of = |(change, found): (&Change, &[Option<(FitQuality, f64)>])| {
            let found = found.iter().flatten();
            let count = |is: fn(FitQuality) -> bool| found.clone().filter(|(fit, _)| is(*fit)).count();
            Tried {
                change: change.clone(),
                fits: count(|fit| fit != FitQuality::None),
                clear: count(|fit| fit == FitQuality::Good),
                log_likelihood: found.map(|(_, log_likelihood)| log_likelihood.max(0.0)).sum(),
            }
        };
        changes.iter().zip(found.chunks(samples.len().max(1))).map(of).collect()
    }

    /// `None` where the image or the field cannot be read, or nothing is found in it.
    fn look(&self, change: &Change, sample: &Sample) -> Option<(FitQuality, f64)> {
        let given = self.eyes.vision.lens();
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
        let other = match change {
            Change::Field(name) => Some(Field::new(load_field(name).ok()?).ok()?),
            _ => None,
        };
        let picture = view(&sample.message, &lens).ok()?;
        let body = self.eyes.body(sample.head).cloned();
        let attitude = Euler { yaw: 0.0, pitch, roll };
        let known = ImagePrior { lens, attitude, tilt_sigma_rad: TILT_SIGMA_RAD, height_m, initial: None, body };
        let located =
            known.locate(&known.look(&picture), other.as_ref().unwrap_or(self.field), self.settings.filter.seed);
        Some((located.fit(), located.found.first()?.log_likelihood))
    }

    /// Other focal lengths, and the shipped lenses with as many pixels.
    fn lenses(&self) -> Vec<Change> {
        let own = self.eyes.vision.lens();
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

fn mounts() -> Vec<Change> {
    let degrees =
        |most: i32, each: f64| (-most..=most).filter(|step| *step != 0).map(move |step| each * f64::from(step));
    let pitches = degrees(PITCHES, PITCH_DEG).map(Change::Pitch);
    let rolls = degrees(ROLLS, ROLL_DEG).chain([UPSIDE_DOWN_DEG]).map(Change::Roll);
    pitches.chain(rolls).chain(scales().map(Change::Height)).collect()
}

fn scales() -> impl Iterator<Item = f64> {
    (-SCALES..=SCALES).filter(|step| *step != 0).map(|step| libm::pow(TIMES, f64::from(step)))
}

/// Those that explain most first.
fn sort(tried: &mut [Tried]) {
    tried.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
}

fn fits_mostly(tried: &Tried, frames: usize) -> bool {
    2 * tried.fits >= frames && tried.fits > 0
}

fn explains_more(tried: &Tried, own: &Tried, times: f64) -> bool {
    tried.log_likelihood > times * own.log_likelihood
}

/// For people: of what explains nothing at all, anything is many times more.
fn times_more(tried: &Tried, own: &Tried) -> f64 {
    (tried.log_likelihood / own.log_likelihood.max(1e-9)).min(99.0)
}

fn fit(count: usize) -> String {
    if count == 1 { "1 fits".to_owned() } else { format!("{count} fit") }
}

impl Change {
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

/// What `work` makes of each index, in their order.
fn in_parallel<T: Send>(threads: usize, count: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::with_capacity(count)));
    std::thread::scope(|scope| {
        for _ in 0..threads.clamp(1, count.max(1)) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= count {
                        break;
                    }
                    let result = work(index);
                    done.lock().unwrap_or_else(PoisonError::into_inner).push((index, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}
