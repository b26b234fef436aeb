//! Looks at images on a pool of threads: the part of the work that does not depend on earlier frames.
//!
//! Frames are taken back in the order in which they went in, so that the number of threads changes no bit of a tag.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use crossbeam_channel::{Receiver, Sender, bounded};

use super::setup::FramePerception;
use realitysim_geometry::Lens;
use realitysim_localization::Rejection;
use realitysim_log_input::decode::{DecodeError, picture_of_size};
use realitysim_log_input::synchroniser::Frame;
use realitysim_ros2::mcap_read::LogMessage;
use realitysim_vision::{Observations, Picture};

/// A frame with the result of looking at its image.
pub struct PerceivedFrame {
    /// The frame.
    pub frame: Frame,
    /// What the image shows, or why it cannot be used.
    pub seen: Result<Observations, PerceptionError>,
    /// Time from the decoded image to the ground table, milliseconds.
    pub look_ms: f64,
}

/// Why an image could not be used.
#[derive(Debug)]
pub enum PerceptionError {
    /// The image does not decode.
    Decode(DecodeError),
    /// The image is not of the size that the lens is calibrated for.
    Size {
        /// Width and height of the image, pixels.
        image: [usize; 2],
        /// Width and height of the lens's images, pixels.
        lens: [u32; 2],
    },
    /// The camera's place on the robot is not known. The frame's `robot.place` holds the error.
    NoPlace,
}

impl PerceptionError {
    /// The reason that the frame's tag states.
    pub fn rejection(&self) -> Rejection {
        match self {
            Self::Decode(_) => Rejection::ImageBroken,
            Self::Size { .. } => Rejection::ImageSize,
            Self::NoPlace => Rejection::NoTransform,
        }
    }
}

/// Frames under way for each worker: one being looked at, one waiting.
const AHEAD: usize = 2;

struct Job {
    frame: Frame,
    /// Observations of an earlier frame, whose buffers are used again.
    spare: Observations,
    reply: Sender<PerceivedFrame>,
}

/// A pool of threads that takes frames and gives them back with what their images show, in the same order.
pub struct PerceptionPool {
    perception: Arc<FramePerception>,
    jobs: Option<Sender<Job>>,
    workers: Vec<std::thread::JoinHandle<()>>,
    pending: VecDeque<Receiver<PerceivedFrame>>,
    limit: usize,
    spares: Vec<Observations>,
}

impl PerceptionPool {
    /// A pool of `threads` threads. With one thread, the work is done in the caller's.
    pub fn new(perception: Arc<FramePerception>, threads: usize) -> Self {
        if threads <= 1 {
            return Self {
                perception,
                jobs: None,
                workers: Vec::new(),
                pending: VecDeque::new(),
                limit: 1,
                spares: Vec::new(),
            };
        }
        let limit = threads * AHEAD;
        let (jobs, queue) = bounded::<Job>(limit);
        let workers = (0..threads)
            .map(|_| {
                let (perception, queue) = (Arc::clone(&perception), queue.clone());
                std::thread::spawn(move || {
                    for job in queue {
                        // Sending fails only if the replay has been given up.
                        let _ = job.reply.send(perceive(&perception, job.frame, job.spare));
                    }
                })
            })
            .collect();
        Self { perception, jobs: Some(jobs), workers, pending: VecDeque::new(), limit, spares: Vec::new() }
    }

    /// Takes a frame and, once enough are under way, hands back the oldest.
    pub fn push(&mut self, frame: Frame) -> Option<PerceivedFrame> {
        let spare = self.spares.pop().unwrap_or_default();
        let Some(jobs) = &self.jobs else { return Some(perceive(&self.perception, frame, spare)) };
        let (reply, result) = bounded(1);
        // Sending cannot fail: the workers live as long as this end of the channel.
        let _ = jobs.send(Job { frame, spare, reply });
        self.pending.push_back(result);
        if self.pending.len() >= self.limit { self.pop() } else { None }
    }

    /// Returns the observations of a finished frame, so that their buffers are used again.
    pub fn give_back(&mut self, seen: Observations) {
        if self.spares.len() < self.limit {
            self.spares.push(seen);
        }
    }

    /// Waits for the oldest frame under way and takes it back; `None` if there is none.
    pub fn pop(&mut self) -> Option<PerceivedFrame> {
        self.pending.pop_front().and_then(|result| result.recv().ok())
    }
}

impl Drop for PerceptionPool {
    fn drop(&mut self) {
        self.jobs = None;
        for worker in self.workers.drain(..) {
            // A worker that panicked has already said so.
            let _ = worker.join();
        }
    }
}

/// Decodes a frame's image and looks at it. `seen` gives the buffers.
fn perceive(perception: &FramePerception, frame: Frame, mut seen: Observations) -> PerceivedFrame {
    let Ok(place) = frame.robot.place.clone() else {
        return PerceivedFrame { frame, seen: Err(PerceptionError::NoPlace), look_ms: 0.0 };
    };
    let picture = match decode_picture(&frame.message, perception.vision.lens()) {
        Ok(picture) => picture,
        Err(unseen) => return PerceivedFrame { frame, seen: Err(unseen), look_ms: 0.0 },
    };
    let start = Instant::now();
    perception.vision.look_again(&picture, &place.footprint_from_optical, perception.body(frame.robot.head), &mut seen);
    PerceivedFrame { look_ms: start.elapsed().as_secs_f64() * 1e3, frame, seen: Ok(seen) }
}

/// Decodes the picture of a frame's message and checks that it has the size of the lens.
pub(super) fn decode_picture(message: &LogMessage, lens: &Lens) -> Result<Picture, PerceptionError> {
    picture_of_size(message, [lens.width() as usize, lens.height() as usize]).map_err(|error| match error {
        DecodeError::OtherSize { found, .. } => {
            PerceptionError::Size { image: found, lens: [lens.width(), lens.height()] }
        }
        error => PerceptionError::Decode(error),
    })
}
