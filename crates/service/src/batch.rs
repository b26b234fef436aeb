//! Answers one request with many views: `multipart/mixed`, each part sent as it is made, in the order of the request.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use http_body_util::BodyExt;
use hyper::body::{Body as HttpBody, Bytes, Frame};
use hyper::header::{CONTENT_TYPE, HeaderValue};
use hyper::{Response, StatusCode};
use serde_json::{Map, Value};
use tokio::sync::OwnedSemaphorePermit;
use tokio::sync::mpsc::{Receiver, Sender, channel};
use tokio::time::sleep;

use super::connections::ConnectionSlot;
use super::encode::Form;
use super::parameters::{Parameters, ViewRequest};
use super::response::{PROBLEM, Reply};
use super::view_service::Picture;
use super::{HttpProblem, Service};
use realitysim_geometry::Isometry;

/// Largest number of views of one request.
const MAX_BATCH: usize = 1024;
/// Longest time for a batch; views that are left then are refused.
const MAX_TIME: Duration = Duration::from_secs(120);
/// Number of parts that are made before the client has begun to take them.
const MAX_AHEAD: usize = 1;
/// Time between two tries to get room for a part.
const LOOK_FOR_ROOM_EVERY: Duration = Duration::from_millis(50);
/// Text between the parts of an answer.
const BOUNDARY: &str = "realitysim-view-8f3b61c7d2a94e05";

/// The views of one request.
pub(super) struct Batch {
    /// The views in the order of the request; an error is what is wrong with one.
    pub(super) asked: Vec<Result<ViewRequest, HttpProblem>>,
}

impl Batch {
    /// Reads `{"poses": [...]}` or `{"from": ..., "to": ..., "count": n}`. Parameters beside these hold for all views.
    pub(super) fn from_json(text: &[u8]) -> Result<Self, HttpProblem> {
        let value: Value =
            serde_json::from_slice(text).map_err(|error| HttpProblem::wrong(format!("not JSON: {error}")))?;
        let Value::Object(mut object) = value else {
            return Err(HttpProblem::wrong("an object is needed: {\"poses\": [{\"x\": 1, ...}, ...]}"));
        };
        let [poses, from, to, count] = ["poses", "from", "to", "count"].map(|name| object.remove(name));
        let all = Parameters::from_json(&object)?;
        let asked: Vec<Result<ViewRequest, HttpProblem>> = match (poses, from, to, count) {
            (Some(Value::Array(poses)), None, None, None) => {
                check_count(poses.len())?;
                poses
                    .iter()
                    .enumerate()
                    .map(|(number, pose)| read_pose(&format!("poses[{number}]"), pose, &all))
                    .collect()
            }
            (None, Some(from), Some(to), Some(count)) => {
                let refused = || {
                    HttpProblem::wrong(format!("count is {count}: a whole number from 1 to {MAX_BATCH} is possible"))
                };
                let whole = |count: &f64| count.fract() == 0.0 && (1.0..=MAX_BATCH as f64).contains(count);
                let count = count.as_f64().filter(whole).map(|count| count as usize);
                let count = count.ok_or_else(refused)?;
                interpolate(&read_pose("from", &from, &all)?, &read_pose("to", &to, &all)?, count)
                    .into_iter()
                    .map(Ok)
                    .collect()
            }
            _ => return Err(HttpProblem::wrong("either poses (a list), or from, to and count are needed")),
        };
        // If all views are wrong, the request is refused with the error of the first.
        match asked.first() {
            Some(Err(refusal)) if asked.iter().all(Result::is_err) => Err(refusal.clone()),
            _ => Ok(Self { asked }),
        }
    }

    /// Returns a reply whose views are made one after the other and sent as they come. `batch` is held until the end.
    pub(super) fn stream(
        self,
        service: Arc<Service>,
        slot: Arc<ConnectionSlot>,
        batch: OwnedSemaphorePermit,
        forms: Vec<Form>,
    ) -> Reply {
        let (send, receive) = channel(MAX_AHEAD);
        tokio::spawn(async move {
            make_parts(&service, &slot, self.asked, forms, &send).await;
            drop(batch);
        });
        let mut reply = Response::new(Parts(receive).boxed());
        let kind = format!("multipart/mixed; boundary={BOUNDARY}");
        if let Ok(kind) = HeaderValue::from_str(&kind) {
            reply.headers_mut().insert(CONTENT_TYPE, kind);
        }
        reply
    }
}

/// Refuses too many views, and none.
fn check_count(count: usize) -> Result<(), HttpProblem> {
    let fits = (1..=MAX_BATCH).contains(&count);
    if fits { Ok(()) } else { Err(HttpProblem::wrong(format!("{count} views: 1 to {MAX_BATCH} with one request"))) }
}

/// Reads one view; `place` says in a refusal where it stands.
fn read_pose(place: &str, pose: &Value, all: &Parameters) -> Result<ViewRequest, HttpProblem> {
    let at = |refusal: HttpProblem| HttpProblem { what: format!("{place}: {}", refusal.what), ..refusal };
    let empty = Map::new();
    let object = pose.as_object();
    let own = Parameters::from_json(object.unwrap_or(&empty)).map_err(at)?;
    own.over(all).view_request().map_err(at)
}

/// Interpolates `count` views from one pose to another, both included: along a straight line, with the shortest turn.
fn interpolate(from: &ViewRequest, to: &ViewRequest, count: usize) -> Vec<ViewRequest> {
    let (a, b) = (from.map_from_link, to.map_from_link);
    let pose = |number: usize| {
        let part = number as f64 / (count.max(2) - 1) as f64;
        Isometry { translation: a.translation.lerp(b.translation, part), rotation: a.rotation.slerp(b.rotation, part) }
    };
    let one =
        |number: usize| ViewRequest { map_from_link: pose(number), frame: from.frame + number as u64, ..from.clone() };
    (0..count).map(one).collect()
}

/// Makes the views and sends them as parts. Ends early when the client has hung up.
async fn make_parts(
    service: &Arc<Service>,
    slot: &Arc<ConnectionSlot>,
    asked: Vec<Result<ViewRequest, HttpProblem>>,
    forms: Vec<Form>,
    send: &Sender<Bytes>,
) {
    let started = Instant::now();
    let forms: Arc<[Form]> = forms.into();
    for asked in asked {
        // No view is made before the client has taken what was made for it.
        let Ok(room) = send.reserve().await else { return };
        let picture = match asked {
            Err(refusal) => Err(refusal),
            Ok(asked) if started.elapsed() < MAX_TIME => make_view(service, asked, &forms).await,
            Ok(_) => Err(too_late()),
        };
        let mut bytes = part(picture);
        let held = loop {
            match slot.hold(bytes) {
                Ok(held) => break held,
                Err(refused) => bytes = refused,
            }
            if started.elapsed() > MAX_TIME || send.is_closed() {
                return;
            }
            sleep(LOOK_FOR_ROOM_EVERY).await;
        };
        room.send(held);
    }
    let _ = send.send(Bytes::from(format!("--{BOUNDARY}--\r\n"))).await;
}

/// Makes one view of a batch when its turn comes.
async fn make_view(service: &Arc<Service>, asked: ViewRequest, forms: &Arc<[Form]>) -> Result<Picture, HttpProblem> {
    let inside = service.admission.next_of_batch().await?;
    let (shared, forms) = (Arc::clone(service), Arc::clone(forms));
    inside.run(move || shared.picture(&asked, &forms)).await?
}

/// Refusal of a view that was not made in time.
fn too_late() -> HttpProblem {
    let what = format!("not made within {} s: ask for fewer with one request", MAX_TIME.as_secs());
    HttpProblem::new(StatusCode::SERVICE_UNAVAILABLE, what)
}

/// Returns one part of the answer, with its headers: a view or a refusal.
fn part(picture: Result<Picture, HttpProblem>) -> Vec<u8> {
    let (status, kind, headers, content) = match picture {
        Ok(picture) => (200, picture.form.media_type(), picture.headers, picture.bytes),
        Err(refusal) => (refusal.status.as_u16(), PROBLEM, Vec::new(), refusal.problem()),
    };
    let mut part = format!(
        "--{BOUNDARY}\r\ncontent-type: {kind}\r\ncontent-length: {}\r\nrealitysim-status: {status}\r\n",
        content.len()
    );
    for (name, value) in headers {
        part.push_str(&format!("{name}: {value}\r\n"));
    }
    part.push_str("\r\n");
    let mut bytes = part.into_bytes();
    bytes.extend(content);
    bytes.extend(b"\r\n");
    bytes
}

/// A body whose frames come through a channel.
struct Parts(Receiver<Bytes>);

impl HttpBody for Parts {
    type Data = Bytes;
    type Error = std::io::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context) -> Poll<Option<Result<Frame<Bytes>, Self::Error>>> {
        self.0.poll_recv(context).map(|bytes| bytes.map(|bytes| Ok(Frame::data(bytes))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_take_what_they_do_not_say_from_all() {
        let text = r#"{"method": "paper", "z": 0.5, "poses": [{"x": 1, "y": 2, "yaw_deg": 3}, {"x": 1, "y": 2, "yaw_deg": 3, "method": "nearest"}]}"#;
        let batch = Batch::from_json(text.as_bytes()).expect("right");
        let methods: Vec<_> = batch.asked.iter().flatten().map(|asked| asked.method).collect();
        assert_eq!(methods, [realitysim_views::Method::Paper, realitysim_views::Method::Nearest]);
    }

    #[test]
    fn a_trajectory_begins_and_ends_where_it_should() {
        let text = r#"{"z": 0.5, "from": {"x": 0, "y": 0, "yaw_deg": 170}, "to": {"x": 1, "y": 2, "yaw_deg": -170}, "count": 5}"#;
        let asked = Batch::from_json(text.as_bytes()).expect("right").asked;
        let asked: Vec<ViewRequest> = asked.into_iter().flatten().collect();
        let middle = asked[2].map_from_link;
        assert!((middle.translation.x - 0.5).abs() < 1e-12 && asked.len() == 5);
        assert!(
            (middle.euler().yaw.abs() - core::f64::consts::PI).abs() < 1e-9,
            "the short way round: {:?}",
            middle.euler()
        );
        assert!((asked[4].map_from_link.translation.y - 2.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place() {
        for (text, words) in [
            ("nonsense", "not JSON"),
            ("[]", "an object is needed"),
            ("{}", "either poses (a list), or from, to and count"),
            (r#"{"poses": []}"#, "0 views: 1 to 1024"),
            (r#"{"poses": [{"x": 1}, {"x": 1}]}"#, "poses[0]: y is missing"),
            (r#"{"poses": [{"x": [1]}]}"#, "poses[0]: x: [1]: a number or a text is needed"),
            (r#"{"poses": [1]}"#, "poses[0]: x is missing"),
            (r#"{"from": {}, "to": {}, "count": 99999}"#, "count is 99999: a whole number from 1 to 1024"),
            (r#"{"from": {}, "to": {}, "count": -1}"#, "count is -1"),
            (r#"{"from": {}, "to": {}, "count": 1e9}"#, "count is 1000000000.0"),
            (r#"{"from": {}, "to": {}, "count": "5"}"#, "count is \"5\""),
        ] {
            let refusal = Batch::from_json(text.as_bytes()).err().expect(text);
            assert!(refusal.status == 400 && refusal.what.contains(words), "{text}: {}", refusal.what);
        }
    }
}
