//! The page about a game: numbers, a time line, a map, and a picture of each time in which the own pose was wrong.

use std::fmt::Write;

use anyhow::Context;
use glam::DVec2;
use image::{ImageFormat, RgbImage};

use super::super::export::frames::each_frame;
use super::super::html::{END, embedded, escaped, head};
use super::{Walk, cause_text, motion_text};
use crate::evaluation::drawing::{Route, RouteStyle, field_map, overlay};
use crate::evaluation::postgame::{Episode, GameFrame, Postgame, WRONG_M};
use crate::geometry::{Field, Isometry, Lens, Pose2};
use crate::log_input::decode;
use crate::ros2::messages::FrameTag;

/// Number of times that have a picture.
const PICTURES: usize = 24;
/// Lines by the tag, and by the own pose.
const TAG_COLOUR: [u8; 3] = [255, 60, 60];
const OWN_COLOUR: [u8; 3] = [60, 200, 255];
/// Size of the time line, pixels.
const LINE_PX: [f64; 2] = [1000.0, 180.0];
/// Greatest distance that the time line shows, metres.
const SHOWN_M: f64 = 3.0;
/// Width of the map, pixels.
const MAP_PX: u32 = 900;

/// Makes the page, which needs no other file.
pub(super) fn page(walk: &Walk, game: &Postgame) -> anyhow::Result<String> {
    let field = Field::new(walk.info.field.clone())?;
    let title = walk.capture.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let map = embedded(&map(walk.frames, &field), ImageFormat::Png)?;
    let (rows, odometry) = (episode_rows(walk, game, &field)?, odometry_rows(game));
    let mut html = head("After the game");
    let _ = writeln!(
        html,
        "<h1>{}</h1><p class=big>The robot's own pose was wrong for <b>{:.1} s</b>, {:.0} % of the time, {} times.</p>\
         <p>{} of {} frames judged. Median {:.1} cm and {:.1}&deg;, 95 % within {:.1} cm. Wrong is more than {:.1} m or 15&deg; off the \
         tag.</p><h2>Distance over time</h2>{}<h2>On the field</h2><p>Red by the tags, blue as the robot believed.</p>{map}\
         <h2>When it was wrong</h2>{rows}<h2>Odometry</h2>{odometry}{END}",
        escaped(&title),
        game.wrong_s,
        100.0 * game.wrong_share,
        game.episodes.len(),
        game.judged,
        game.frames,
        100.0 * game.median_m,
        game.median_yaw_deg,
        100.0 * game.p95_m,
        WRONG_M,
        time_line(walk.frames, &game.episodes),
    );
    Ok(html)
}

/// The distance of the own pose over time, wrong times shaded.
fn time_line(frames: &[GameFrame], episodes: &[Episode]) -> String {
    let [width, height] = LINE_PX;
    let Some((first, last)) = frames.first().zip(frames.last()) else { return String::new() };
    let length_s = ((last.stamp_ns - first.stamp_ns) as f64 * 1e-9).max(1e-3);
    let x = |seconds: f64| width * seconds / length_s;
    let y = |metres: f64| height - 20.0 - (height - 30.0) * (metres / SHOWN_M).min(1.0);
    let mut svg = format!("<svg viewBox=\"0 0 {width} {height}\" role=img aria-label=\"distance over time\">");
    for Episode { from_s, until_s, cause, .. } in episodes {
        let (left, across) = (x(*from_s), (x(*until_s) - x(*from_s)).max(2.0));
        let _ = write!(
            svg,
            "<rect x={left:.1} y=0 width={across:.1} height={:.0} fill=#e33 opacity=.2><title>{}</title></rect>",
            height - 20.0,
            cause_text(*cause)
        );
    }
    for metres in [WRONG_M, 1.0, 2.0, 3.0] {
        let _ = write!(
            svg,
            "<line x1=0 x2={width} y1={0:.1} y2={0:.1} stroke=#888 stroke-width=.5 /><text x=2 y={1:.1} font-size=11 fill=#888>{metres} \
             m</text>",
            y(metres),
            y(metres) - 2.0
        );
    }
    let mut before: Option<i64> = None;
    let mut path = String::new();
    for frame in frames {
        let Some((metres, _)) = frame.error() else { continue };
        let joined = before.is_some_and(|before| frame.stamp_ns - before < 500_000_000);
        let at = (frame.stamp_ns - first.stamp_ns) as f64 * 1e-9;
        let _ = write!(path, "{}{:.1} {:.1}", if joined { 'L' } else { 'M' }, x(at), y(metres));
        before = Some(frame.stamp_ns);
    }
    let _ = write!(svg, "<path d=\"{path}\" fill=none stroke=#36c stroke-width=1.5 />");
    for step in 0..=10 {
        let at = length_s * f64::from(step) / 10.0;
        let _ =
            write!(svg, "<text x={:.1} y={:.0} font-size=11 fill=#888>{at:.0} s</text>", x(at) * 0.97, height - 4.0);
    }
    svg + "</svg>"
}

/// The field with both routes.
fn map(frames: &[GameFrame], field: &Field) -> RgbImage {
    let route = |label: &str, of: fn(&GameFrame) -> Option<Pose2>, colour| Route {
        label: label.to_owned(),
        colour,
        // A frame without a pose is a gap.
        points: frames.iter().map(|frame| of(frame).map_or(DVec2::NAN, |pose| DVec2::new(pose.x, pose.y))).collect(),
        style: RouteStyle::Thin,
        dots: false,
    };
    let tagged = route("tags", |frame| frame.tagged, TAG_COLOUR);
    let routes = [tagged, route("own pose", |frame| frame.own, OWN_COLOUR)];
    field_map(field, &routes, MAP_PX, &[])
}

/// A row for each time in which the own pose was wrong, with a picture of its worst frame.
fn episode_rows(walk: &Walk, game: &Postgame, field: &Field) -> anyhow::Result<String> {
    if game.episodes.is_empty() {
        return Ok("<p>Never.</p>".to_owned());
    }
    let pictures = pictures(walk, &game.episodes, field)?;
    let mut rows = String::new();
    for episode in &game.episodes {
        let Episode { from_s, until_s, worst_m, worst_deg, cause, worst_stamp_ns } = episode;
        let _ = write!(
            rows,
            "<figure><figcaption><b>{from_s:.1} to {until_s:.1} s: {}.</b> Up to {worst_m:.2} m and {worst_deg:.0}&deg; \
             off.</figcaption>",
            cause_text(*cause)
        );
        if let Some((_, picture)) = pictures.iter().find(|(stamp_ns, _)| stamp_ns == worst_stamp_ns) {
            rows.push_str(picture);
        }
        rows.push_str("</figure>");
    }
    rows.insert_str(0, "<p>In the pictures lines are red where the tag puts them, blue where the own pose does.</p>");
    Ok(rows)
}

/// Pictures of the worst frames, by stamp.
fn pictures(walk: &Walk, episodes: &[Episode], field: &Field) -> anyhow::Result<Vec<(i64, String)>> {
    let lens = Lens::new(walk.info.lens.clone())?;
    let wanted: Vec<i64> = episodes.iter().take(PICTURES).map(|episode| episode.worst_stamp_ns).collect();
    let is_wanted = |tag: &&FrameTag| wanted.contains(&tag.header.stamp.to_nanoseconds());
    let tags: Vec<FrameTag> = walk.tags.iter().filter(is_wanted).cloned().collect();
    let mut pictures = Vec::new();
    let (_, _lost) = each_frame(walk.capture, &tags, &mut |tag, message| {
        let stamp_ns = tag.header.stamp.to_nanoseconds();
        let picture = match decode::picture(message) {
            Ok(picture) => picture,
            Err(error) => return Ok(Err(error.to_string())),
        };
        let (width, height) = (picture.width as u32, picture.height as u32);
        let image = RgbImage::from_raw(width, height, picture.to_rgb()).context("an image of its size")?;
        let map_from_link = Isometry::from(tag.pose.pose);
        let mut shown = overlay(&image, &lens, &map_from_link, field, TAG_COLOUR);
        let frame = walk.frames.iter().find(|frame| frame.stamp_ns == stamp_ns);
        if let Some((own, tagged)) = frame.and_then(|frame| frame.own.zip(frame.tagged)) {
            // The camera that stands on the robot as it does, on the place that the robot believed.
            let believed = own.to_isometry() * tagged.to_isometry().inverse() * map_from_link;
            shown = overlay(&shown, &lens, &believed, field, OWN_COLOUR);
        }
        pictures.push((stamp_ns, embedded(&shown, ImageFormat::Jpeg)?));
        Ok(Ok(()))
    })?;
    Ok(pictures)
}

fn odometry_rows(game: &Postgame) -> String {
    let mut table = String::from("<table><tr><th>direction<th>moved<th>the robot moves, of it</tr>");
    for direction in &game.odometry.directions {
        let (name, unit) = motion_text(direction.motion);
        let scale = match direction.scale.zip(direction.sigma) {
            Some((scale, sigma)) => format!("{scale:.3} &plusmn; {sigma:.3}"),
            None => "too little motion to tell".to_owned(),
        };
        let _ = write!(table, "<tr><td>{name}<td>{:.1} {unit}<td>{scale}</tr>", direction.moved);
    }
    let _ = write!(
        table,
        "</table><p>After these scales {:.1} cm and {:.1}&deg; of a second's motion are left (root mean square over {} s).</p>",
        100.0 * game.odometry.left_m,
        game.odometry.left_deg,
        game.odometry.seconds
    );
    table
}
