//! Makes ROS 2 messages, named as ROS names them, of what other writers put into MCAP logs.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::Arc;

use super::foxglove::{FoxgloveError, FoxgloveType};
use realitysim_ros2::mcap_read::{Channel, LogMessage};

/// Converts the messages of one file, channel by channel.
#[derive(Default)]
pub struct MessageConverter {
    /// For each number of a channel: the channel as the file has it, and what its messages become.
    channels: HashMap<u16, (Arc<Channel>, Treatment)>,
}

/// What is done with the messages of a channel.
#[derive(Clone)]
enum Treatment {
    /// They are ROS 2 messages, or of no known type, and stay as they are.
    Keep,
    /// They are ROS 2 messages whose type is spelled otherwise.
    Rename(Arc<Channel>),
    /// They are of Foxglove's schemas.
    Convert(FoxgloveType, Arc<Channel>),
}

impl Treatment {
    fn of(channel: &Channel) -> Self {
        if let Some(kind) = FoxgloveType::of(&channel.type_name, &channel.message_encoding) {
            return Self::Convert(kind, Arc::new(kind.ros2_channel(channel)));
        }
        match ros2_type_name(&channel.type_name, &channel.message_encoding) {
            Cow::Borrowed(_) => Self::Keep,
            Cow::Owned(type_name) => Self::Rename(Arc::new(Channel { type_name, ..channel.clone() })),
        }
    }
}

impl MessageConverter {
    /// Converts a message. `true` says that its bytes are no longer those of the file. Fails if the bytes of a message of
    /// Foxglove's schemas are not what its type says.
    pub fn convert(&mut self, message: LogMessage) -> Result<(LogMessage, bool), FoxgloveError> {
        Ok(match self.treatment(&message.channel) {
            Treatment::Keep => (message, false),
            Treatment::Rename(channel) => (LogMessage { channel, ..message }, false),
            Treatment::Convert(kind, channel) => {
                let data = kind.to_ros2(message.data)?;
                (LogMessage { channel, data, ..message }, true)
            }
        })
    }

    fn treatment(&mut self, channel: &Arc<Channel>) -> Treatment {
        match self.channels.get(&channel.id) {
            Some((known, treatment)) if Arc::ptr_eq(known, channel) => treatment.clone(),
            _ => {
                let treatment = Treatment::of(channel);
                self.channels.insert(channel.id, (Arc::clone(channel), treatment.clone()));
                treatment
            }
        }
    }
}

/// Returns the name of a type as the messages of [`MessageConverter`] have it.
///
/// The ROS 2 types of Foxglove's schemas stand for these. Names of CDR messages are written as rosbag2 writes them,
/// `package/msg/Name`: mcap-ros2-support's example has `package/Name` (foxglove/mcap, python/examples/ros2-noenv/writer.py), and
/// recorders of DDS `package::msg::dds_::Name_` (eProsima/DDS-Record-Replay, ddsreplayer/test/resources/constants.hpp).
pub fn ros2_type_name<'a>(type_name: &'a str, message_encoding: &str) -> Cow<'a, str> {
    if let Some(kind) = FoxgloveType::of(type_name, message_encoding) {
        return Cow::Owned(kind.ros2_name().to_owned());
    }
    if message_encoding != "cdr" {
        return Cow::Borrowed(type_name);
    }
    let parts: Vec<&str> = type_name.split("::").flat_map(|part| part.split('/')).collect();
    let (package, name) = match parts[..] {
        [package, name] => (package, name),
        [package, "msg", name] if type_name.contains("::") => (package, name),
        [package, "msg", "dds_", name] => (package, name.strip_suffix('_').unwrap_or(name)),
        _ => return Cow::Borrowed(type_name),
    };
    Cow::Owned(format!("{package}/msg/{name}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_spelling_of_a_type_becomes_that_of_rosbag2() {
        for spelled in
            ["sensor_msgs/msg/Image", "sensor_msgs/Image", "sensor_msgs::msg::Image", "sensor_msgs::msg::dds_::Image_"]
        {
            assert_eq!(ros2_type_name(spelled, "cdr"), "sensor_msgs/msg/Image", "{spelled}");
        }
        for kept in ["", "Image", "acme/deep/msg/Image", "a::b::Image", "foxglove.CompressedImage"] {
            assert_eq!(ros2_type_name(kept, "cdr"), kept);
        }
        assert_eq!(ros2_type_name("sensor_msgs/Image", "ros1"), "sensor_msgs/Image");
    }

    #[test]
    fn protobuf_of_foxglove_and_no_other_becomes_ros() {
        assert_eq!(ros2_type_name("foxglove.RawImage", "protobuf"), "sensor_msgs/msg/Image");
        for (name, encoding) in
            [("foxglove.RawImage", "json"), ("foxglove.Grid", "protobuf"), ("acme.RawImage", "protobuf")]
        {
            assert_eq!(ros2_type_name(name, encoding), name);
        }
    }
}
