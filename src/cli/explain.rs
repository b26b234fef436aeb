//! Command `realitysim explain`: shows why the tag of a frame is what it is.

use std::path::{Path, PathBuf};

use clap::Args;
use glam::DVec2;
use serde_json::{Value, json};

use super::paths::{check_output, save};
use super::photo::{self, OtherInputs, PhotoArguments};
use super::replay::source_field;
use super::settings::{SettingsArguments, UsageError};
use super::values::any_whole;
use super::{Outcome, output, settings};
use crate::config::Settings;
use crate::evaluation::drawing::{self, Route, RouteStyle};
use crate::geometry::{Field, Isometry, Lens, Pose2, wrap_angle};
use crate::localization::refinement::line_measurement::Finding;
use crate::localization::validation::THRESHOLDS;
use crate::localization::{Evidence, Rejection, TriedPose};
use crate::tagging::explanation::{self, ExplainOptions, Explanation, Sight};
use crate::tagging::image_location::{FitQuality, ImageLocation};

/// Show why the tag of one frame, or the pose of one image, is what it is
///
/// Tags a log or scene up to that frame as `replay` does without filter.budget_ms; a JPEG or PNG as `tag` does on the field of the
/// settings. Draws over the picture where the pose has lines and what the picture shows there, what shows a line where the field has
/// none, and the carpet's border. Says what makes the tag invalid and what to do about it. A map beside the picture has the pose and
/// those that a search of the whole field finds in this picture alone.
#[derive(Args)]
#[command(after_long_help = concat!(
    "Example:",
    "\n  realitysim explain my_bag/ --field kid-2020 --frame 42 -o frame42.png",
    "\n  realitysim explain photo.jpg --lens camera.yaml --attitude 0,25 --height 0.55 -o why.png",
))]
pub struct ExplainArguments {
    /// A log, a folder of logs, a capture or a scene; or a JPEG or PNG
    #[arg(value_name = "LOG|SCENE|IMAGE")]
    source: PathBuf,
    /// Which frame of the log, counted from 0
    #[arg(long, value_name = "N", value_parser = any_whole::<u64>)]
    frame: Option<u64>,
    /// Picture to write
    #[arg(short, long, value_name = "PNG")]
    output: Option<PathBuf>,
    /// Pose of base_footprint at the first frame, in place of what the log announces; of an image, about where camera_link is
    #[arg(long, value_name = "x,y,yaw_deg", value_parser = settings::planar_pose, allow_hyphen_values = true)]
    initial: Option<Pose2>,
    #[command(flatten)]
    photo: PhotoArguments,
    #[command(flatten)]
    settings: SettingsArguments,
}

pub fn run(arguments: &ExplainArguments, json: bool) -> anyhow::Result<Outcome> {
    if let Some(picture) = &arguments.output {
        let named = arguments.settings.files();
        let inputs: Vec<_> = named.iter().map(PathBuf::as_path).chain([arguments.source.as_path()]).collect();
        check_output(picture, &inputs)?;
    }
    let settings = arguments.settings.resolve_for(&arguments.source)?;
    let is_image = arguments
        .source
        .extension()
        .is_some_and(|ending| ["jpg", "jpeg", "png"].iter().any(|image| ending.eq_ignore_ascii_case(image)));
    let explained = if is_image { of_image(arguments, settings)? } else { of_frame(arguments, settings)? };
    if let (Some(path), Some(sight)) = (&arguments.output, &explained.sight) {
        save(&picture(&explained, sight)?, path)?;
    }
    if json {
        output::json(&report(&explained))?;
    } else {
        output::lines(&text(&explained, arguments.output.as_deref()))?;
    }
    Ok(Outcome::Whole)
}

/// Result for a frame or an image, to be printed, drawn and reported.
struct Explained {
    /// Pose of `camera_link`, if it is known.
    map_from_camera: Option<Isometry>,
    lens: Lens,
    field: Field,
    sight: Option<Sight>,
    /// Explanation in words, a line each.
    told: Vec<String>,
    /// Fields of the JSON report that only a frame, or only an image, has.
    report: Value,
}

fn of_frame(arguments: &ExplainArguments, settings: Settings) -> anyhow::Result<Explained> {
    let source = arguments.source.display();
    if let Some(name) = arguments.photo.first_given() {
        return Err(UsageError(format!(
            "{name} is of an image, and {source} is none: a log says how its camera stood"
        ))
        .into());
    }
    let Some(frame) = arguments.frame else {
        return Err(UsageError(format!("--frame is missing: which frame of {source}, counted from 0")).into());
    };
    if let Some(initial) = &arguments.initial {
        let (name, field) = source_field(&arguments.source, &settings)?;
        settings::check_initial(initial, &name, &field)?;
    }
    let options = ExplainOptions { source: arguments.source.clone(), settings, initial: arguments.initial, frame };
    let mut progress = output::Progress::new("tagging");
    let explanation = explanation::explain(&options, &mut |done, total| progress.set(done, total));
    progress.finish();
    let explanation = explanation?;
    let told = explain_frame(&explanation);
    let Explanation { tag, lens, field, map_from_camera, sight } = explanation;
    let report = json!({
        "frame": tag.sequence, "valid": tag.valid, "reason": tag.reason, "ambiguous": tag.ambiguous, "refined": tag.refined,
    });
    Ok(Explained { map_from_camera: Some(map_from_camera), lens, field, sight, told, report })
}

fn of_image(arguments: &ExplainArguments, settings: Settings) -> anyhow::Result<Explained> {
    let image = &arguments.source;
    if arguments.frame.is_some() {
        return Err(UsageError(format!("--frame is of a log, and {} is an image", image.display())).into());
    }
    let Some(lens) = &settings.camera.lens else {
        return Err(UsageError("--lens is missing: the lens file of the image's camera".to_owned()).into());
    };
    let field = Field::new(settings.field_dimensions()?)?;
    if let Some(initial) = &arguments.initial {
        settings::check_initial(initial, &settings.field, &field)?;
    }
    let body_mask = settings.camera.body_mask.first().map(|mask| mask.png.as_str());
    let beside = OtherInputs { lens, body_mask, initial: arguments.initial };
    let (picture, known) = arguments.photo.open(image, &beside)?;
    let look = known.look(&picture, field.line_width());
    let located = known.locate(&look, &field, settings.filter.seed);
    let evidence = known.evidence(&look, &field, &located);
    let told = explain_image(&located, evidence.as_ref());
    let report = json!({"fit": located.fit()});
    let map_from_camera = located.found.first().map(|best| best.map_from_link);
    let sight = evidence.map(|evidence| Sight { picture, evidence });
    Ok(Explained { map_from_camera, lens: known.lens, field, sight, told, report })
}

fn text(explained: &Explained, picture: Option<&Path>) -> String {
    let mut lines = explained.told.clone();
    if let Some(Sight { evidence, .. }) = &explained.sight {
        lines.push("\nthe whole field, searched for this picture alone:".to_owned());
        lines.push("       x m     y m   yaw deg   worth  places that fit  explained".to_owned());
        lines.extend(evidence.tried.iter().map(|tried| {
            let TriedPose { x, y, yaw_deg, worth, fitting, explained } = tried;
            format!("  {x:8.2}{y:8.2}{yaw_deg:10.1}{worth:8.1}{fitting:17}{:9.0} %", 100.0 * explained)
        }));
    }
    match (picture, &explained.sight) {
        (Some(path), Some(_)) => lines.push(format!("\n{}", path.display())),
        (Some(_), None) => lines.push("\nno picture was written: nothing could be seen".to_owned()),
        _ => {}
    }
    lines.join("\n")
}

fn picture(explained: &Explained, sight: &Sight) -> anyhow::Result<image::RgbImage> {
    let Explained { lens, field, told, .. } = explained;
    let Sight { picture, evidence } = sight;
    let map_from_camera = explained.map_from_camera.unwrap_or(Isometry::IDENTITY);
    let drawn = drawing::explanation(&photo::rgb(picture)?, lens, &map_from_camera, field, evidence);
    let at = map_from_camera.translation.truncate();
    let ahead = |at: DVec2, yaw: f64| vec![at, at + 0.4 * DVec2::from_angle(yaw)];
    let mut routes = vec![Route {
        label: "the camera".to_owned(),
        colour: [230, 30, 60],
        points: ahead(at, map_from_camera.euler().yaw),
        style: RouteStyle::Thin,
        dots: false,
    }];
    routes.extend(evidence.tried.iter().take(3).enumerate().map(|(rank, tried)| Route {
        label: format!("search, {}", ["best", "second", "third"][rank]),
        colour: [[30, 60, 230], [90, 120, 240], [150, 170, 250]][rank],
        points: ahead(DVec2::new(tried.x, tried.y), wrap_angle(tried.yaw_deg.to_radians())),
        style: RouteStyle::Thin,
        dots: false,
    }));
    let mut caption = told.clone();
    caption.push("circle: the camera, or where a search puts it or the robot; cross: 40 cm ahead".to_owned());
    caption.push(drawing::LEGEND.to_owned());
    let map = drawing::field_map(field, &routes, 760, &caption);
    Ok(drawing::beside(&drawn, &map))
}

/// Explains a frame: its tag, what was seen, and what to do.
fn explain_frame(explanation: &Explanation) -> Vec<String> {
    let tag = &explanation.tag;
    let mut lines = vec![if tag.valid {
        format!("frame {} is valid", tag.sequence)
    } else {
        format!("frame {} is invalid: {}", tag.sequence, tag.reason)
    }];
    let Some(Sight { evidence, .. }) = &explanation.sight else {
        lines.push(advice(&tag.reason, None).to_owned());
        return lines;
    };
    lines.extend(describe_evidence(evidence));
    if !tag.valid {
        lines.push(advice(&tag.reason, Some(evidence)).to_owned());
    }
    lines
}

/// Explains an image in the same way.
fn explain_image(located: &ImageLocation, evidence: Option<&Evidence>) -> Vec<String> {
    let fit = located.fit();
    let mut lines = vec![match fit {
        FitQuality::Good => "the fit is good".to_owned(),
        FitQuality::Doubtful => "the fit is doubtful".to_owned(),
        FitQuality::None => "no pose found".to_owned(),
    }];
    lines.extend(evidence.into_iter().flat_map(describe_evidence));
    match (fit, located.rival()) {
        (FitQuality::None, _) => lines.push(photo::explain_no_pose(Some(located))),
        (FitQuality::Doubtful, Some(rival)) => {
            let Pose2 { x, y, yaw } = rival.place();
            let yaw_deg = yaw.to_degrees();
            lines.push(format!(
                "the pose at {x:.2}, {y:.2}, yaw {yaw_deg:.0} deg explains the lines nearly as well: say about where it was (--initial)"
            ));
        }
        (FitQuality::Doubtful, None) => lines.push(
            "the pose explains too little: lines that should be seen are not (red), or lines are seen where the field has none (magenta). \
             If red marks lie beside painted lines, check --lens, --attitude and --height; if magenta ones lie on real lines, --field"
                .to_owned(),
        ),
        (FitQuality::Good, _) => {}
    }
    lines
}

/// Describes what was seen.
fn describe_evidence(evidence: &Evidence) -> Vec<String> {
    let Evidence { agreement, explained, explained_in_view, contrast, noise, .. } = evidence;
    let mut lines = Vec::new();
    if contrast.is_finite() {
        lines.push(format!(
            "the best lines in view are {:.0} % brighter than the carpet, whose own noise is {:.1} %",
            100.0 * contrast,
            100.0 * noise
        ));
    } else {
        lines.push("nothing in view stands out of the carpet as a line does".to_owned());
    }
    lines.push(format!(
        "{} of {} line places fit; counted by how probably such a picture shows a line so thin, {:.0} % fit, and {:.0} % stand out more \
         than anything within 16 pixels beside them",
        agreement.fitting,
        agreement.expected,
        100.0 * agreement.share,
        100.0 * agreement.foremost
    ));
    lines.push(match agreement.digits {
        digits if digits < THRESHOLDS.agrees_digits => "chance puts as many there".to_owned(),
        digits => format!("chance would put as many there once in 10^{digits:.0} pictures"),
    });
    lines.push(format!(
        "of the line seen near the robot {:.0} % is painted where the pose has it, of all lines in view {:.0} %",
        100.0 * explained.share,
        100.0 * explained_in_view
    ));
    lines
}

/// Says what to do about a rejection reason.
pub(super) fn advice(reason: &str, evidence: Option<&Evidence>) -> &'static str {
    let sees_no_line = evidence.is_some_and(|evidence| evidence.lines.is_empty() || !evidence.contrast.is_finite());
    let is_chance = evidence.is_some_and(|evidence| evidence.agreement.digits < THRESHOLDS.agrees_digits);
    let Some(rejection) = Rejection::from_reason(reason) else {
        return "docs/reference/formats.md says what this reason means";
    };
    match rejection {
        Rejection::PoseUnknown | Rejection::FewLines if sees_no_line => {
            "no line is in view: turn the head towards lines, or check that the camera sees the carpet at all"
        }
        Rejection::PoseUnknown if is_chance => {
            "nothing in the picture lies where the field's lines would be more often than by chance: it shows none of them, or is too noisy"
        }
        Rejection::PoseUnknown => {
            "no place of the field explains this frame: if red marks lie beside painted lines in the picture, then field, lens or mount are \
             not what they are said to be; if magenta marks lie on real lines, the field is another"
        }
        Rejection::Unconfirmed
            if evidence.is_some_and(|evidence| evidence.explained_in_view < THRESHOLDS.explained_in_view) =>
        {
            "lines in view lie where the field has none: the robot is elsewhere, field, lens or mount are not what they are said to be, or \
             something else on the carpet looks like a line"
        }
        Rejection::Unconfirmed => {
            "the pose fits, and needs more evidence: further frames that agree, or a place that is told (/initialpose)"
        }
        Rejection::FewLines => "too few lines are in view to follow the pose: it is carried on by odometry alone",
        Rejection::LinesDisagree => {
            "lines that should be seen are not (red): something hides them, the robot is elsewhere, or field, lens or mount are wrong"
        }
        Rejection::LinesUnexplained => {
            "lines are seen where the field has none (magenta): tape or another field's lines on the carpet, or the robot is elsewhere"
        }
        Rejection::NotStanding => {
            "the lines put the camera higher, lower or more tilted than IMU and mount say: check the mount's height and pitch"
        }
        Rejection::Spread => {
            "the lines in view leave the position open along one direction: see filter.valid_refined_m"
        }
        Rejection::OffField => "the pose lies more than a metre beyond the carpet",
        Rejection::SensorsStale => {
            "odometry or IMU are older than 250 ms at this frame: check that they are sent and how their clocks run"
        }
        Rejection::NoOdometry => "there is no odometry for this time",
        Rejection::Fallen => "the IMU says that the robot leans or lies",
        Rejection::TooDark => "the picture is black: exposure, lens cap, cable",
        Rejection::Overexposed => "more than half of the picture is white: exposure",
        Rejection::ImageFrozen => "the same picture came again although the robot moved: the camera hangs",
        Rejection::ImageBroken => "the image does not decode",
        Rejection::ImageSize => "the image is not of the lens's size: another lens file, or another size of the camera",
        Rejection::NoTransform => "the camera's place on the robot is not known: /tf_static, or [mount] in the config",
        _ => "docs/reference/formats.md says what this reason means",
    }
}

fn report(explained: &Explained) -> Value {
    let mut report = explained.report.clone();
    report["camera_in_map"] = explained.map_from_camera.map_or(Value::Null, |pose| {
        let (at, tilt) = (pose.translation, pose.euler());
        json!({"x": at.x, "y": at.y, "z": at.z, "yaw": tilt.yaw, "pitch": tilt.pitch, "roll": tilt.roll})
    });
    report["told"] = json!(explained.told);
    if let Some(Sight { evidence, .. }) = &explained.sight {
        let Evidence { agreement, explained, explained_in_view, contrast, noise, lines, shown, tried, .. } = evidence;
        let lines: Vec<Value> = lines
            .iter()
            .map(|line| {
                let (finding, found) = match line.finding {
                    Finding::Found(at) => ("found", Some([at.x, at.y])),
                    Finding::Missing => ("missing", None),
                    Finding::Hidden => ("hidden", None),
                };
                json!({"pixel": [line.pixel.x, line.pixel.y], "visibility": line.visibility, "finding": finding, "found": found})
            })
            .collect();
        let unexplained = shown.iter().filter(|(_, is_on_line)| !is_on_line).count();
        report["evidence"] = json!({
            "contrast": contrast.is_finite().then_some(contrast), "noise": noise,
            "expected": agreement.expected, "fitting": agreement.fitting, "share": agreement.share,
            "foremost": agreement.foremost, "digits": agreement.digits, "rms_px": agreement.rms_px,
            "explained": explained.share, "explained_in_view": explained_in_view, "shown_m2": explained.shown_m2,
            "shown_places": shown.len(), "unexplained_places": unexplained,
            "lines": lines, "tried": tried,
        });
    }
    report
}
