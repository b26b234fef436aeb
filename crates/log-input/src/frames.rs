//! From a stream of messages to frames, each with the robot's state at its exposure.

use super::measurement::{self, Measurement};
use super::synchroniser::{Frame, Synchroniser};
use realitysim_config::{HeadSettings, Topics};
use realitysim_ros2::cdr::CdrError;
use realitysim_ros2::mcap_read::LogMessage;

/// Decodes messages and gives out the frames whose measurements are complete.
///
/// Messages are pushed one by one, as they arrive at the recorder, or pulled from a log with [`Self::frames_of`].
pub struct FrameAssembler {
    topics: Topics,
    head: HeadSettings,
    /// Brings the measurements together in time.
    pub synchroniser: Synchroniser,
    /// The caller gave the initial pose, so that poses announced in the messages are ignored.
    initial_is_given: bool,
    unreadable: u64,
}

impl FrameAssembler {
    /// An assembler that has taken no message. With `initial_is_given`, poses that are announced in the messages are ignored.
    pub fn new(topics: Topics, head: HeadSettings, synchroniser: Synchroniser, initial_is_given: bool) -> Self {
        Self { topics, head, synchroniser, initial_is_given, unreadable: 0 }
    }

    /// The measurement in a message; an error if the content is not what its type says.
    pub fn read(&self, message: &LogMessage) -> Result<Measurement, CdrError> {
        measurement::read(message, &self.topics, &self.head)
    }

    /// Takes a measurement that was read from this message.
    pub fn push(&mut self, message: &LogMessage, measurement: Measurement) {
        if !(self.initial_is_given && matches!(measurement, Measurement::InitialPose { .. })) {
            self.synchroniser.push(message, measurement);
        }
    }

    /// Takes a message. A message of the ground truth is ignored, one that cannot be read is counted.
    pub fn take(&mut self, message: &LogMessage) {
        if message.channel.topic == self.topics.ground_truth {
            return;
        }
        match self.read(message) {
            Ok(measurement) => self.push(message, measurement),
            Err(_) => self.unreadable += 1,
        }
    }

    /// The next frame whose measurements are complete.
    pub fn pop(&mut self) -> Option<Frame> {
        self.synchroniser.pop()
    }

    /// Number of messages whose content is not what their type says.
    pub fn unreadable(&self) -> u64 {
        self.unreadable
    }

    /// All frames of a log, up to the first error.
    pub fn frames_of<E, Messages>(&mut self, messages: Messages) -> Frames<'_, Messages>
    where
        Messages: Iterator<Item = Result<LogMessage, E>>,
    {
        Frames { assembler: self, messages: Some(messages) }
    }
}

/// Iterator over the frames of a log. At the end of the messages, frames go out with what is known of them.
pub struct Frames<'a, Messages> {
    assembler: &'a mut FrameAssembler,
    /// `None` after the last message.
    messages: Option<Messages>,
}

impl<E, Messages: Iterator<Item = Result<LogMessage, E>>> Iterator for Frames<'_, Messages> {
    type Item = Result<Frame, E>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(frame) = self.assembler.pop() {
                return Some(Ok(frame));
            }
            match self.messages.as_mut()?.next() {
                Some(Ok(message)) => self.assembler.take(&message),
                Some(Err(error)) => return Some(Err(error)),
                None => {
                    self.messages = None;
                    self.assembler.synchroniser.finish();
                    return self.assembler.pop().map(Ok);
                }
            }
        }
    }
}
