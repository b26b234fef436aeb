//! The part of a frame's work that needs nothing of the frames before it, on as many threads as wanted.
//!
//! Frames go to a pool of workers and are taken back in their order, so that the number of threads changes no bit.

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

/// A frame after looking at it.
pub struct PerceivedFrame {
    pub frame: Frame,
    pub seen: Result<Observations, PerceptionError>,
    /// Milliseconds from the decoded image to the ground table.
    pub look_ms: f64,
}

/// Why nothing could be seen.
#[derive(Debug)]
pub enum PerceptionError {
    Decode(DecodeError),
    Size {
        image: [usize; 2],
        lens: [u32; 2],
    },
    /// The camera's place is not known: the message is in the frame.
    NoPlace,
}

impl PerceptionError {
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
    /// Of a frame that is done with: its buffers are used again.
    spare: Observations,
    reply: Sender<PerceivedFrame>,
}

/// Frames in, looked-at frames out, in the same order.
pub struct PerceptionPool {
    eyes: Arc<FramePerception>,
    jobs: Option<Sender<Job>>,
    workers: Vec<std::thread::JoinHandle<()>>,
    pending: VecDeque<Receiver<PerceivedFrame>>,
    limit: usize,
    spares: Vec<Observations>,
}

impl PerceptionPool {
    /// With one thread everything happens in the caller's.
    pub fn new(eyes: Arc<FramePerception>, threads: usize) -> Self {
        if threads <= 1 {
            return Self {
                eyes,
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
                let (eyes, queue) = (Arc::clone(&eyes), queue.clone());
                std::thread::spawn(move || {
                    for job in queue {
                        // Nobody waits any more when the replay has been given up.
                        let _ = job.reply.send(look(&eyes, job.frame, job.spare));
                    }
                })
            })
            .collect();
        Self { eyes, jobs: Some(jobs), workers, pending: VecDeque::new(), limit, spares: Vec::new() }
    }

    /// Takes a frame and, once enough are under way, hands back the oldest.
    pub fn push(&mut self, frame: Frame) -> Option<PerceivedFrame> {
        let spare = self.spares.pop().unwrap_or_default();
        let Some(jobs) = &self.jobs else { return Some(look(&self.eyes, frame, spare)) };
        let (reply, result) = bounded(1);
        // The workers live as long as this end of the channel.
        let _ = jobs.send(Job { frame, spare, reply });
        self.pending.push_back(result);
        if self.pending.len() >= self.limit { self.pop() } else { None }
    }

    /// What a frame has shown is not needed any more.
    pub fn give_back(&mut self, seen: Observations) {
        if self.spares.len() < self.limit {
            self.spares.push(seen);
        }
    }

    /// The oldest frame under way.
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

fn look(eyes: &FramePerception, frame: Frame, mut seen: Observations) -> PerceivedFrame {
    let Ok(place) = frame.robot.place.clone() else {
        return PerceivedFrame { frame, seen: Err(PerceptionError::NoPlace), look_ms: 0.0 };
    };
    let picture = match view(&frame.message, eyes.vision.lens()) {
        Ok(picture) => picture,
        Err(unseen) => return PerceivedFrame { frame, seen: Err(unseen), look_ms: 0.0 },
    };
    let start = Instant::now();
    eyes.vision.look_again(&picture, &place.footprint_from_optical, eyes.body(frame.robot.head), &mut seen);
    PerceivedFrame { look_ms: start.elapsed().as_secs_f64() * 1e3, frame, seen: Ok(seen) }
}

/// The picture of a frame's message, if it is one that the lens can have made.
pub(super) fn view(message: &LogMessage, lens: &Lens) -> Result<Picture, PerceptionError> {
    picture_of_size(message, [lens.width() as usize, lens.height() as usize]).map_err(|error| match error {
        DecodeError::OtherSize { found, .. } => {
            PerceptionError::Size { image: found, lens: [lens.width(), lens.height()] }
        }
        error => PerceptionError::Decode(error),
    })
}
