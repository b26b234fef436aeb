//! A robot that is watched while it records, as the page shows it.

use std::fmt::Debug;

use hyper::StatusCode;
use jpeg_encoder::ColorType;
use serde_json::{Value, json};

use super::HttpProblem;
use realitysim_log_input::{decode, encode};
use realitysim_vision::Reduction;

/// A recorder on a robot. How it is reached is no business of the service.
pub trait LiveRobot: Debug + Send + Sync {
    /// Returns what is known of it: `robot`, `connected`, `why` it is not, `status`, `words`, `frame` (tag, field, lens, lines), `age_s`.
    fn state(&self) -> Value;

    /// Returns the image of the frame whose tag has this number, or of the latest one: a JPEG or PNG. `None` if it is not held any more, or if
    /// the camera's images are raw.
    fn picture(&self, sequence: Option<u32>) -> Option<Vec<u8>>;

    /// Gives it an order: `mark TEXT`, `place X,Y,YAW_DEG` (metres, degrees), `start` or `stop`. `Err` says why it is not done.
    fn order(&self, order: &str) -> Result<Value, String>;
}

/// Longest order, bytes: the recorder takes no longer one.
const MAX_ORDER_BYTES: usize = 4096;

/// Returns what is known of the robot; of none that there is none.
pub(super) fn state(robot: Option<&dyn LiveRobot>) -> Value {
    let Some(robot) = robot else { return json!({ "watched": false }) };
    let mut state = robot.state();
    state["watched"] = true.into();
    state
}

/// Which picture of the robot a client wants.
#[derive(Clone, Copy, Debug)]
pub(super) struct PictureRequest {
    /// The frame whose tag has this number; `None` for the latest.
    pub(super) sequence: Option<u32>,
    /// Largest width, pixels: a thin link carries no more. `None` for the image as the camera made it.
    pub(super) width: Option<u32>,
    /// Quality of a JPEG that is made smaller, 1 to 100.
    pub(super) quality: u8,
}

/// Largest factor by which a picture is made smaller.
const MAX_REDUCTION: usize = 8;

/// Returns a frame's image and its media type.
pub(super) fn picture(
    robot: Option<&dyn LiveRobot>,
    wanted: PictureRequest,
) -> Result<(Vec<u8>, &'static str), HttpProblem> {
    let none = || match wanted.sequence {
        Some(number) => HttpProblem::new(
            StatusCode::NOT_FOUND,
            format!("the picture of frame {number} is not here, or not any more"),
        ),
        None => HttpProblem::new(StatusCode::NOT_FOUND, "there is no picture: /v1/live says why"),
    };
    let picture = robot.and_then(|robot| robot.picture(wanted.sequence)).ok_or_else(none)?;
    if let Some(width) = wanted.width
        && let Some(smaller) = reduced(&picture, width as usize, wanted.quality)
    {
        return Ok((smaller, "image/jpeg"));
    }
    let media_type = if picture.starts_with(b"\x89PNG") { "image/png" } else { "image/jpeg" };
    Ok((picture, media_type))
}

/// Makes a JPEG of at most some width, by a whole factor. `None` if the image is not wider, or does not decode: then it is shown as it is.
fn reduced(image: &[u8], max_width: usize, quality: u8) -> Option<Vec<u8>> {
    let whole = decode::compressed(image).ok()?;
    let factor = whole.width.div_ceil(max_width.max(1)).min(MAX_REDUCTION);
    if factor < 2 {
        return None;
    }
    let mut room = Reduction::default();
    let small = whole.reduced(factor, &mut room);
    encode::jpeg(&small.to_rgb(), small.width, small.height, ColorType::Rgb, quality).ok()
}

/// Gives the robot the order of a body, `{"order": "mark goal"}`, and returns its answer.
pub(super) fn order(robot: Option<&dyn LiveRobot>, body: &[u8]) -> Result<Value, HttpProblem> {
    let order = order_in(body)?;
    let none = "no robot is watched: `realitysim live robot:` does that";
    let robot = robot.ok_or_else(|| HttpProblem::new(StatusCode::NOT_FOUND, none))?;
    robot.order(&order).map_err(|why| HttpProblem::new(StatusCode::CONFLICT, why))
}

fn order_in(body: &[u8]) -> Result<String, HttpProblem> {
    let right = "{\"order\": \"mark TEXT\"}, or place X,Y,YAW_DEG, start or stop";
    let wrong = || HttpProblem::wrong(format!("the body is no order: {right}"));
    let value: Value = serde_json::from_slice(body).map_err(|_| wrong())?;
    let order = value["order"].as_str().ok_or_else(wrong)?;
    let (word, text) = order.split_once(' ').unwrap_or((order, ""));
    let is_known = match word {
        "mark" | "place" => !text.trim().is_empty(),
        "start" | "stop" => text.is_empty(),
        _ => false,
    };
    let is_one_line = order.len() < MAX_ORDER_BYTES && !order.contains(['\n', '\r']);
    if is_known && is_one_line { Ok(order.to_owned()) } else { Err(wrong()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_orders_that_there_are_go_to_the_robot() {
        for right in [r#"{"order": "mark goal!"}"#, r#"{"order": "place 1,-2,90"}"#, r#"{"order": "stop"}"#] {
            assert!(order_in(right.as_bytes()).is_ok(), "{right}");
        }
        let long = format!(r#"{{"order": "mark {}"}}"#, "a".repeat(MAX_ORDER_BYTES));
        for wrong in [
            "",
            "stop",
            "{}",
            r#"{"order": 1}"#,
            r#"{"order": "poses"}"#,
            r#"{"order": "stop now"}"#,
            r#"{"order": "mark "}"#,
            r#"{"order": "mark a\nstop"}"#,
            &long,
        ] {
            assert!(order_in(wrong.as_bytes()).is_err_and(|refusal| refusal.status == 400), "{wrong}");
        }
    }
}
