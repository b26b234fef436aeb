//! Command `realitysim import`: makes a log of pictures or a video, and of tables of what was measured meanwhile.

pub(super) mod pictures;
pub(super) mod video;

use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::{Args, ValueEnum};
use glam::DVec3;
use serde::Serialize;

use super::paths::{self, cannot_read, check_output, check_replaceable};
use super::settings::{UsageError, numbers};
use super::values::number;
use super::{Outcome, output};
use crate::config::{FrameNames, lens_file, load_lens_for_image, plain_file};
use crate::geometry::{Euler, Isometry, LensParameters};
use crate::log_input::tables::messages::{WalkMessages, WalkTables, pictures_within};
use crate::log_input::tables::stamp::{StampUnit, seconds};
use crate::log_input::tables::transforms::TransformSample;
use crate::log_input::tables::{
    AngleUnit, MAX_TABLE_BYTES, Measured, Table, TableError, imu, joints, odometry, transforms,
};
use crate::log_input::transforms::TransformTree;
use crate::recording::Loss;
use crate::ros2::LogMessage;
use crate::ros2::mcap_write::{LogWriter, RawChannel, WriteError};
use crate::tagging::warnings::scaled_lens;

/// Make a log of a folder of pictures or a video, without ROS
///
/// SOURCE is a folder of JPEG and PNG files, or a video (frames are taken with ffmpeg). When each picture was taken is said by
/// --stamps, by a time in its name (seconds, milliseconds, microseconds or nanoseconds since 1970), or by --rate. Tables are
/// CSV with commas, semicolons or tabs, and a head that names the columns; angles carry their unit (roll_deg, yaw_rad). Axes are those of ROS:
/// x forward, y left, z up; pitch and tilt above 0 look down.
///
/// `realitysim replay` takes the log. docs/howto/pictures.md goes through it step by step.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Examples:",
    "\n  realitysim import frames/ --lens cam.yaml --height 0.5 --imu i.csv --odometry o.csv -o walk.mcap",
    "\n  realitysim import clip.mp4 --rate 30 --lens cam.yaml --transforms camera.csv -o clip.mcap",
))]
pub struct ImportArguments {
    /// A folder of JPEG and PNG files, or a video
    #[arg(value_name = "FOLDER|VIDEO")]
    source: PathBuf,
    /// Lens file (of ROS, OpenCV, Kalibr, OCamCalib, mrcal, VisualMesh or this program), shipped camera, or equidistant:180deg
    #[arg(long, value_name = "FILE")]
    lens: String,
    /// When each picture was taken: image,stamp; of a video stamp alone, a row for each frame
    #[arg(long, value_name = "CSV", conflicts_with = "rate")]
    stamps: Option<PathBuf>,
    /// Pictures a second, in the order of their names, 0.001 to 10000; the first is taken at the first stamp of the tables
    #[arg(long, value_name = "HZ", value_parser = number(0.001..=10_000.0))]
    rate: Option<f64>,
    /// Attitude of the torso: stamp, and roll_deg,pitch_deg[,yaw_deg] or qx,qy,qz,qw; perhaps gx_rad_s,gy_rad_s,gz_rad_s and
    /// ax,ay,az (m/s^2, or ax_g ..)
    #[arg(long, value_name = "CSV")]
    imu: Option<PathBuf>,
    /// Odometry of the point on the ground below the robot: stamp, and x,y,yaw_deg (metres) or vx,vy,wz_deg_s
    #[arg(long, value_name = "CSV")]
    odometry: Option<PathBuf>,
    /// Angles of the head: stamp,pan_deg,tilt_deg
    #[arg(long, value_name = "CSV")]
    joints: Option<PathBuf>,
    /// Height of the camera above the ground while the robot stands upright and looks straight ahead, 0.02 to 20
    #[arg(long, value_name = "M", value_parser = number(0.02..=20.0), conflicts_with = "transforms")]
    height: Option<f64>,
    /// Camera in the torso, whose attitude --imu is of: metres and degrees [default: in its origin, level]
    #[arg(long, value_name = "x,y,z,pitch_deg", value_parser = mount, allow_hyphen_values = true, requires = "height")]
    mount: Option<Isometry>,
    /// In place of --height and --mount: parent,child,x,y,z, and roll_deg,pitch_deg,yaw_deg or qx,qy,qz,qw, from base_footprint to
    /// camera_link; with stamp where they move
    #[arg(long, value_name = "CSV")]
    transforms: Option<PathBuf>,
    /// Unit of columns of angles whose names have none
    #[arg(long, value_name = "deg|rad")]
    angles: Option<Angles>,
    /// The log to write
    #[arg(short, long, value_name = "LOG")]
    output: PathBuf,
}

#[derive(Clone, Copy, ValueEnum)]
enum Angles {
    Deg,
    Rad,
}

impl From<Angles> for AngleUnit {
    fn from(angles: Angles) -> Self {
        match angles {
            Angles::Deg => Self::Degrees,
            Angles::Rad => Self::Radians,
        }
    }
}

#[derive(Serialize)]
struct Report {
    log: PathBuf,
    pictures: u64,
    from_s: String,
    to_s: String,
    size: [usize; 2],
    tables: Vec<TableReport>,
    /// What is taken for granted.
    assumed: Vec<String>,
    /// What the walk lacks, and what to do about it.
    warnings: Vec<String>,
    lost: Vec<Loss>,
}

/// What was read of a table.
#[derive(Serialize)]
struct TableReport {
    file: PathBuf,
    rows: usize,
    /// Unit of the stamps; null without stamps.
    stamps: Option<&'static str>,
    ignored_columns: Vec<String>,
}

/// Tables as they are read, with what is to be said about them.
#[derive(Default)]
struct Reader {
    reports: Vec<TableReport>,
    assumed: Vec<String>,
}

impl Reader {
    /// Reads a table that may have been named.
    fn read<T>(
        &mut self,
        path: Option<&Path>,
        read: impl FnOnce(&mut Table) -> Result<Measured<T>, TableError>,
    ) -> anyhow::Result<Option<Vec<T>>> {
        let Some(path) = path else { return Ok(None) };
        let text = plain_file::read_text(path, MAX_TABLE_BYTES).map_err(|error| cannot_read(path, error))?;
        let name = path.display().to_string();
        let mut table = Table::parse(&text, &name)?;
        let Measured { rows, stamps, assumed } = read(&mut table)?;
        self.assumed.extend(assumed.into_iter().map(|what| format!("{name}: {what}")));
        self.tell_unit(&name, stamps);
        self.reports.push(TableReport {
            file: path.to_owned(),
            rows: rows.len(),
            stamps: stamps.map(|stamps| stamps.unit.suffix()),
            ignored_columns: table.ignored_columns(),
        });
        Ok(Some(rows))
    }

    fn tell_unit(&mut self, of: &str, stamps: Option<StampUnit>) {
        if let Some(StampUnit { unit, is_recognized: true }) = stamps {
            self.assumed.push(format!("{of}: stamps are {unit}, by their magnitude"));
        }
    }
}

pub fn run(arguments: &ImportArguments, json: bool) -> anyhow::Result<Outcome> {
    let inputs = inputs(arguments);
    check_output(&arguments.output, &inputs.iter().map(PathBuf::as_path).collect::<Vec<_>>())?;
    check_replaceable(&arguments.output, mcap::MAGIC)?;
    let mut reader = Reader::default();
    let tables = read_tables(arguments, &mut reader)?;
    let spans = spans(arguments, &tables);
    let mut source = if arguments.source.is_dir() {
        pictures::Source::of_folder(arguments, &mut reader, &spans)?
    } else {
        pictures::Source::of_video(arguments, &mut reader, &spans)?
    };
    let warnings = check_overlap(&source, &spans)?;
    let mut report = write(arguments, &tables, &spans, &mut source)?;
    let Reader { reports, assumed } = reader;
    report.tables = reports;
    report.assumed.splice(0..0, assumed);
    report.warnings = warnings;
    report.warnings.extend(lacks(&tables));
    tell(&report, json)?;
    Ok(Outcome::of(&report.lost))
}

/// All files that are read, over which the log must not be written.
fn inputs(arguments: &ImportArguments) -> Vec<PathBuf> {
    let ImportArguments { stamps, imu, odometry, joints, transforms, .. } = arguments;
    let tables = [stamps, imu, odometry, joints, transforms].into_iter().flatten().cloned();
    // A log may be written into the folder of the pictures: none of them has its name.
    let source = (!arguments.source.is_dir()).then(|| arguments.source.clone());
    tables.chain(source).chain(lens_file(&arguments.lens)).collect()
}

fn read_tables(arguments: &ImportArguments, reader: &mut Reader) -> anyhow::Result<WalkTables> {
    let angles = arguments.angles.map(AngleUnit::from);
    let transforms = match reader.read(arguments.transforms.as_deref(), |table| transforms::read(table, angles))? {
        Some(rows) => rows,
        None => mount_of(arguments)?,
    };
    check_mount(arguments, &transforms)?;
    Ok(WalkTables {
        transforms,
        imu: reader.read(arguments.imu.as_deref(), |table| imu::read(table, angles))?.unwrap_or_default(),
        odometry: reader
            .read(arguments.odometry.as_deref(), |table| odometry::read(table, angles))?
            .unwrap_or_default(),
        joints: reader.read(arguments.joints.as_deref(), |table| joints::read(table, angles))?.unwrap_or_default(),
    })
}

/// The constant transforms that --height and --mount state.
fn mount_of(arguments: &ImportArguments) -> Result<Vec<TransformSample>, UsageError> {
    let Some(height_m) = arguments.height else {
        let what = "--height is missing: how high the camera is above the ground while the robot stands upright (or --transforms)";
        return Err(UsageError(what.to_owned()));
    };
    let mount = arguments.mount.unwrap_or(Isometry::IDENTITY);
    let torso_height_m = height_m - mount.translation.z;
    if torso_height_m < 0.0 {
        let z = mount.translation.z;
        return Err(UsageError(format!(
            "--mount has the camera {z} m above the torso's origin and --height {height_m} m above the ground: then that origin lies \
             below the ground"
        )));
    }
    let FrameNames { base_footprint, base_link, camera_link, .. } = FrameNames::default();
    let constant = |parent: &str, child: &str, parent_from_child| TransformSample {
        stamp_ns: None,
        parent: parent.to_owned(),
        child: child.to_owned(),
        parent_from_child,
    };
    let torso = Isometry::from_euler(Euler::default(), DVec3::new(0.0, 0.0, torso_height_m));
    Ok(vec![constant(&base_footprint, &base_link, torso), constant(&base_link, &camera_link, mount)])
}

/// Checks that transforms lead from the ground to a camera above it.
fn check_mount(arguments: &ImportArguments, transforms: &[TransformSample]) -> anyhow::Result<()> {
    let names = FrameNames::default();
    let mut tree = TransformTree::default();
    tree.set_static(&names.camera_link, &names.camera_optical, Isometry::link_from_optical());
    for TransformSample { stamp_ns, parent, child, parent_from_child } in transforms {
        match stamp_ns {
            None => tree.set_static(parent, child, *parent_from_child),
            Some(stamp_ns) => {
                tree.push(*stamp_ns, parent, child, *parent_from_child);
            }
        }
    }
    let from = arguments.transforms.as_ref().map_or("--mount".to_owned(), |path| path.display().to_string());
    tree.check_constants(&names, false).with_context(|| format!("{from}: the mount cannot be right"))
}

/// The time that a table covers.
struct Span {
    file: PathBuf,
    span_ns: [i64; 2],
}

fn spans(arguments: &ImportArguments, tables: &WalkTables) -> Vec<Span> {
    let ImportArguments { odometry, imu, joints, transforms, .. } = arguments;
    let ends = |first: Option<i64>, last: Option<i64>| Some([first?, last?]);
    let moving = || tables.transforms.iter().filter_map(|sample| sample.stamp_ns);
    let spans = [
        (odometry, ends(tables.odometry.first().map(|s| s.stamp_ns), tables.odometry.last().map(|s| s.stamp_ns))),
        (imu, ends(tables.imu.first().map(|s| s.stamp_ns), tables.imu.last().map(|s| s.stamp_ns))),
        (joints, ends(tables.joints.first().map(|s| s.stamp_ns), tables.joints.last().map(|s| s.stamp_ns))),
        (transforms, ends(moving().min(), moving().max())),
    ];
    spans.into_iter().filter_map(|(file, span_ns)| Some(Span { file: file.clone()?, span_ns: span_ns? })).collect()
}

/// Refuses pictures that were all taken while a table has nothing; returns what is to be said about single ones.
fn check_overlap(source: &pictures::Source, spans: &[Span]) -> anyhow::Result<Vec<String>> {
    let Some([first_ns, last_ns]) = source.span_ns() else { return Ok(Vec::new()) };
    let mut warnings = Vec::new();
    for Span { file, span_ns } in spans {
        let (count, within) = (source.stamps_ns().count(), pictures_within(source.stamps_ns(), *span_ns));
        let file = file.display();
        let [from, to] = span_ns.map(seconds);
        if within == 0 {
            anyhow::bail!(
                "{file} goes from {from} to {to} s, and the pictures were taken from {} to {} s: no picture lies within it. \
                 Both need stamps of one clock in the right unit (name the column stamp_s, stamp_ms, stamp_us or stamp_ns)",
                seconds(first_ns),
                seconds(last_ns)
            );
        }
        if within < count {
            warnings.push(format!(
                "{file}: {} of {count} pictures lie outside of its time ({from} to {to} s), and will have no valid tag",
                count - within
            ));
        }
    }
    Ok(warnings)
}

/// What a replay will miss.
fn lacks(tables: &WalkTables) -> Vec<String> {
    let mut lacks = Vec::new();
    let is_moving = tables.transforms.iter().any(|sample| sample.stamp_ns.is_some());
    if tables.odometry.is_empty() {
        lacks.push("without --odometry replay with `--motion random_walk`: poses are less certain".to_owned());
    }
    if tables.imu.is_empty() && !is_moving {
        lacks.push("without --imu the torso is taken to stand upright: tags are right only while it does".to_owned());
    }
    lacks
}

/// Writes the log beside its place, and moves it there when it is whole.
fn write(
    arguments: &ImportArguments,
    tables: &WalkTables,
    spans: &[Span],
    source: &mut pictures::Source,
) -> anyhow::Result<Report> {
    let output = &arguments.output;
    let pending = paths::PendingFile::create(output)?;
    let mut log = Log::new(pending, output)?;
    let mut messages = WalkMessages::new(tables);
    let mut progress = output::Progress::new("importing");
    let (mut lens, mut lost, mut pictures) = (None, Vec::new(), 0u64);
    let [mut from_ns, mut to_ns] = [i64::MAX, i64::MIN];
    while let Some(picture) = source.next(&mut lost)? {
        let pictures::Picture { name, stamp_ns, data, size } = picture;
        match &lens {
            None => {
                let parameters = lens_for(arguments, &name, size)?;
                let first_ns = spans.iter().map(|span| span.span_ns[0]).fold(stamp_ns, i64::min);
                for message in messages.constants(first_ns, &parameters) {
                    log.write(&message)?;
                }
                lens = Some((parameters, name, size));
            }
            Some((_, first, first_size)) if *first_size != size => {
                let [[width, height], [first_width, first_height]] = [size, *first_size];
                anyhow::bail!(
                    "{name} is {width} x {height} pixels, and {first} {first_width} x {first_height}: the pictures of one camera have \
                     one size; move the others into a folder of their own"
                );
            }
            Some(_) => {}
        }
        while let Some(message) = messages.next_until(stamp_ns) {
            log.write(&message)?;
        }
        log.write(&messages.picture(stamp_ns, data))?;
        [from_ns, to_ns] = [from_ns.min(stamp_ns), to_ns.max(stamp_ns)];
        pictures += 1;
        progress.set(pictures, source.count());
    }
    let Some((lens, _, size)) = lens else {
        let all: Vec<String> = lost.iter().map(ToString::to_string).take(3).collect();
        anyhow::bail!("{}: none of its pictures can be read: {}", arguments.source.display(), all.join("; "));
    };
    while let Some(message) = messages.next_until(i64::MAX) {
        log.write(&message)?;
    }
    log.finish()?;
    progress.finish();
    let fov = lens.fov_deg.map(|fov_deg| {
        let lens = &arguments.lens;
        format!("a log does not hold the lens's angle of view ({fov_deg} deg): replay with `--lens {lens}` to use it")
    });
    let assumed = source.assumed().into_iter().chain(fov).collect();
    let [from_s, to_s] = [from_ns, to_ns].map(seconds);
    let log = output.clone();
    Ok(Report { log, pictures, from_s, to_s, size, tables: Vec::new(), assumed, warnings: Vec::new(), lost })
}

/// Loads the lens for the size of the first picture.
fn lens_for(arguments: &ImportArguments, name: &str, [width, height]: [usize; 2]) -> anyhow::Result<LensParameters> {
    let lens = load_lens_for_image(&arguments.lens, width as u32, height as u32);
    let lens = lens.with_context(|| format!("{name} is {width} x {height} pixels"))?;
    if let Some(stated) = lens.scaled_from {
        output::say(&scaled_lens(&arguments.lens, stated, [width as u32, height as u32]));
    }
    Ok(lens.lens.parameters().clone())
}

/// A log that is being written.
struct Log {
    writer: LogWriter<paths::PendingFile>,
    path: PathBuf,
}

impl Log {
    fn new(file: paths::PendingFile, path: &Path) -> anyhow::Result<Self> {
        let writer = LogWriter::new(file).map_err(|error| cannot_log(path, error))?;
        Ok(Self { writer, path: path.to_owned() })
    }

    fn write(&mut self, message: &LogMessage) -> anyhow::Result<()> {
        let LogMessage { channel, sequence, log_time_ns, publish_time_ns, data } = message;
        // A channel that is added again is the same one.
        let id = self.writer.add_raw_channel(&RawChannel::from(channel.as_ref()));
        let written = id.and_then(|id| self.writer.write(id, *sequence, *log_time_ns, *publish_time_ns, data));
        written.map_err(|error| cannot_log(&self.path, error))
    }

    fn finish(self) -> anyhow::Result<()> {
        let file = self.writer.finish().map_err(|error| cannot_log(&self.path, error))?;
        file.keep()
    }
}

fn cannot_log(path: &Path, error: WriteError) -> anyhow::Error {
    match error {
        WriteError::Io(error) => paths::cannot_write(path, error),
        error => anyhow::Error::new(error).context(path.display().to_string()),
    }
}

fn tell(report: &Report, json: bool) -> anyhow::Result<()> {
    for table in report.tables.iter().filter(|table| !table.ignored_columns.is_empty()) {
        output::say(&format!("{}: not used: {}", table.file.display(), table.ignored_columns.join(", ")));
    }
    report.assumed.iter().chain(&report.warnings).for_each(|what| output::say(what));
    output::losses(&report.lost);
    if json {
        return output::json(report);
    }
    let Report { pictures, size: [width, height], from_s, to_s, log, .. } = report;
    output::lines(&format!("{pictures} pictures of {width} x {height}, {from_s} to {to_s} s\n{}", log.display()))
}

fn mount(text: &str) -> Result<Isometry, String> {
    let [x, y, z, pitch_deg] = numbers::<4>(text, "x,y,z,pitch_deg")?;
    for (name, value, most) in [("x", x, 2.0), ("y", y, 2.0), ("z", z, 20.0), ("pitch_deg", pitch_deg, 90.0)] {
        if value.abs() > most {
            return Err(format!("{name} is {value}: it must be -{most} to {most}"));
        }
    }
    let tilt = Euler { pitch: pitch_deg.to_radians(), ..Euler::default() };
    Ok(Isometry::from_euler(tilt, DVec3::new(x, y, z)))
}
