//! A log, damaged as messages or as a file, through the whole agent; some of what it leaves, into the next start.

use std::collections::BTreeSet;
use std::sync::Arc;

use mcap::{Compression, WriteOptions};
use realitysim::config::Settings;
use realitysim::log_input::foxglove::FoxgloveType;
use realitysim::ros2::messages::Stamp;
use realitysim::ros2::{Channel, LogMessage};

use crate::bytes;
use crate::case::{Case, Outcome};
use crate::draw::Draw;
use crate::fields::Target;
use crate::judge::{self, Judge};
use crate::support::{CAMERA_INFO, IMAGE, IMU, INITIAL, ODOMETRY, TF, TF_STATIC, foreign_log, own_log, stamp_later};
use crate::walks::{Truth, options, replayed};
use crate::worker::forget_peak;

const JOINTS: &str = "/joint_states";

pub fn run(case: &mut Case) -> Outcome {
    // Most robots are told where they start; to search the whole field takes long.
    let which = *case.draw.one_of(&[0, 0, 0, 0, 1, 1, 1, 2]);
    let walk = &case.walks.all[which];
    case.tell(walk.name);
    let mut truth = walk.truth.clone();
    let mut damage = Damage { truth: &mut truth, trusted: true };
    let mut messages = walk.messages.clone();
    if case.draw.chance(0.01) {
        packed(case, &mut messages);
    }
    if case.draw.chance(0.85) {
        for _ in 0..*case.draw.one_of(&[1, 1, 1, 2, 3]) {
            messages = damage.messages(case, messages);
        }
    }
    let trusted = damage.trusted;
    let mut log = written(&mut case.draw, &messages);
    if case.draw.chance(0.25) {
        if case.draw.chance(0.5) {
            bytes::damage(&mut case.draw, &mut log);
        } else {
            bytes::number(&mut case.draw, &mut log, false);
        }
        case.tell("bytes of the file");
    }
    // What it took to make the log is not the program's.
    forget_peak();
    let source = case.write("log.mcap", log);
    let captures = case.path("captures");
    let options = options(source, captures.clone(), Settings::default());
    let judge = Judge { truth: trusted.then_some(&truth), mirrored: which == 2 };
    let taken = judge::replay(&replayed(&options), &captures, judge)?;
    if case.draw.chance(0.1) {
        after(case, &options.captures)?;
    }
    Ok(taken)
}

/// The next log is sound, and begins with what the damaged one has left.
pub fn after(case: &mut Case, captures: &std::path::Path) -> Outcome {
    case.tell("then a sound log with a warm start");
    let walk = &case.walks.all[0];
    let source = case.write("sound.mcap", walk.log());
    let mut options = options(source, captures.to_owned(), Settings::default());
    options.warm_start = true;
    let report = replayed(&options);
    // What the damaged one left of its own was judged before.
    judge::replay(&report, captures, Judge { truth: None, mirrored: true })
}

/// Messages of megabytes that pack to nothing.
fn packed(case: &mut Case, messages: &mut Vec<LogMessage>) {
    let mut message = messages[case.draw.below(messages.len())].clone();
    let (count, megabytes) = *case.draw.one_of(&[(1, 1), (30, 1), (2, 60), (1, 120)]);
    let keep = message.data.len().min(64);
    message.data.truncate(keep);
    message.data.resize(megabytes << 20, 0);
    let at = case.draw.below(messages.len());
    case.tell(format!("{count} messages of {megabytes} MB on {}", message.channel.topic));
    messages.splice(at..at, std::iter::repeat_n(message, count));
}

fn written(draw: &mut Draw, messages: &[LogMessage]) -> Vec<u8> {
    let options = WriteOptions::new();
    match draw.below(6) {
        0 => foreign_log(options.compression(None).chunk_size(Some(20_000)), messages),
        // Without checksums, so that damage reaches the messages.
        1 => foreign_log(options.compression(None).use_chunks(false), messages),
        2 => foreign_log(options.compression(Some(Compression::Zstd)).calculate_chunk_crcs(false), messages),
        3 => foreign_log(options.compression(Some(Compression::Lz4)).chunk_size(Some(5_000)), messages),
        _ => own_log(messages),
    }
}

struct Damage<'a> {
    /// Loses what nobody can know any more.
    truth: &'a mut Truth,
    /// Whether what tells the camera's place on the robot, its lens and the start is as it was.
    trusted: bool,
}

impl Damage<'_> {
    fn messages(&mut self, case: &mut Case, mut messages: Vec<LogMessage>) -> Vec<LogMessage> {
        let topics: BTreeSet<String> = messages.iter().map(|message| message.channel.topic.clone()).collect();
        let known =
            [IMU, IMU, IMU, ODOMETRY, ODOMETRY, ODOMETRY, IMAGE, IMAGE, CAMERA_INFO, TF_STATIC, INITIAL, JOINTS, TF];
        let known: Vec<&str> = known.into_iter().filter(|topic| topics.contains(*topic)).collect();
        if known.is_empty() {
            return messages;
        }
        let topic = *case.draw.one_of(&known);
        if [CAMERA_INFO, TF_STATIC, TF, JOINTS, INITIAL].contains(&topic) {
            self.trusted = false;
        }
        let of_topic: Vec<usize> = messages
            .iter()
            .enumerate()
            .filter(|(_, message)| message.channel.topic == topic)
            .map(|(at, _)| at)
            .collect();
        let hit = hit(&mut case.draw, &of_topic);
        let Some(first) = hit.first().copied() else { return messages };
        let before: Vec<Option<i64>> = messages.iter().map(stamp_of).collect();
        let count = hit.len();
        let draw = &mut case.draw;
        let told = match draw.below(13) {
            0..=5 => {
                let Some(target) = Target::drawn(draw, &messages[first]) else { return messages };
                hit.iter().enumerate().for_each(|(already, at)| target.apply(&mut messages[*at], already));
                format!("{} {:?}", target.name, target.change)
            }
            6 => {
                hit.iter().for_each(|at| bytes::damage(draw, &mut messages[*at].data));
                "bytes".to_owned()
            }
            7 => {
                hit.iter().for_each(|at| bytes::number(draw, &mut messages[*at].data, true));
                "numbers anywhere".to_owned()
            }
            8 => {
                let by_ns = *draw.one_of(&[
                    -1,
                    1_000_000,
                    -300_000_000,
                    40_000_000,
                    3_600_000_000_000,
                    -2_000_000_000_000_000_000,
                ]);
                hit.iter()
                    .filter(|at| messages[**at].data.len() >= 12)
                    .copied()
                    .collect::<Vec<_>>()
                    .into_iter()
                    .for_each(|at| stamp_later(&mut messages[at], by_ns));
                format!("stamps later by {by_ns} ns")
            }
            9 => {
                for at in &hit {
                    messages[*at].log_time_ns = draw.whole(messages[*at].log_time_ns as u64, 63) as i64;
                    messages[*at].publish_time_ns = draw.whole(messages[*at].publish_time_ns as u64, 63) as i64;
                }
                "log times".to_owned()
            }
            10 => {
                // From the back, so that places before stay what they are.
                let way = draw.below(3);
                for at in hit.iter().rev() {
                    let twin = messages[*at].clone();
                    match way {
                        0 => drop(messages.remove(*at)),
                        1 => messages.insert(*at, twin),
                        _ => {
                            let to = draw.below(messages.len());
                            messages.swap(*at, to);
                        }
                    }
                }
                case.tell(format!("{topic}: {} of {count}", ["left out", "twice", "elsewhere"][way]));
                return messages;
            }
            11 => {
                let known: Vec<String> = topics.into_iter().collect();
                let mut channel = Channel::clone(&messages[first].channel);
                match draw.below(5) {
                    0 => channel.topic = draw.one_of(&known).clone(),
                    1 => {
                        channel.type_name =
                            (*draw.one_of(&["", "sensor_msgs/msg/Imu", "sensor_msgs/Imu", "x", "foxglove."]))
                                .to_owned();
                        if channel.type_name == "foxglove." {
                            channel.type_name = draw.one_of(&FoxgloveType::ALL).name().to_owned();
                            channel.message_encoding = "protobuf".to_owned();
                        }
                    }
                    2 => channel.message_encoding = (*draw.one_of(&["", "json", "cdr"])).to_owned(),
                    3 => channel.definition = draw.bytes(40).into(),
                    _ => channel.schema_encoding = (*draw.one_of(&["", "ros2idl", "jsonschema"])).to_owned(),
                }
                // Under a number of its own, or in place of the old one.
                channel.id = *draw.one_of(&[channel.id, 900]);
                let channel = Arc::new(channel);
                hit.iter().for_each(|at| messages[*at].channel = Arc::clone(&channel));
                format!("channel {} of {} as {}", channel.topic, channel.type_name, channel.message_encoding)
            }
            _ if topic == IMAGE => {
                let made = picture(draw);
                let told = format!("another picture of {} bytes", made.len());
                hit.iter().for_each(|at| replace_image(&mut messages[*at], &made));
                told
            }
            _ => {
                let data = messages[draw.below(messages.len())].data.clone();
                hit.iter().for_each(|at| messages[*at].data = data.clone());
                "the bytes of another message".to_owned()
            }
        };
        if topic == IMAGE {
            for at in &hit {
                let now = stamp_of(&messages[*at]);
                if now != before[*at] {
                    // Which frame it is, only the order could tell.
                    for stamp in [now, before[*at]].into_iter().flatten() {
                        self.truth.remove(&stamp);
                    }
                }
            }
        }
        case.tell(format!(
            "{topic}: {told} in {count} from the {}. on",
            of_topic.iter().position(|at| *at == first).unwrap_or(0)
        ));
        messages
    }
}

/// One message, a run of them, some, or all.
fn hit(draw: &mut Draw, of: &[usize]) -> Vec<usize> {
    let first = draw.below(of.len());
    match draw.below(5) {
        0 | 1 => of[first..first + 1].to_vec(),
        2 => of[first..(first + 1 + draw.below(20)).min(of.len())].to_vec(),
        3 => of.iter().copied().filter(|_| draw.chance(0.2)).collect(),
        _ => of.to_vec(),
    }
}

fn stamp_of(message: &LogMessage) -> Option<i64> {
    let sec = i32::from_le_bytes(message.data.get(4..8)?.try_into().ok()?);
    let nanosec = u32::from_le_bytes(message.data.get(8..12)?.try_into().ok()?);
    Some(Stamp { sec, nanosec }.to_nanoseconds())
}

/// Of a compressed image only the pixels: stamp, frame and format stay.
fn replace_image(message: &mut LogMessage, made: &[u8]) {
    use realitysim::ros2::Message;
    use realitysim::ros2::messages::CompressedImage;
    if let Ok(mut image) = CompressedImage::decode(&message.data) {
        image.data = made.to_vec();
        message.data = image.encode();
    }
}

/// Noise, stripes, one colour, or the head of a picture that is far larger than its bytes.
pub fn picture(draw: &mut Draw) -> Vec<u8> {
    let (width, height) = *draw.one_of(&[(320u16, 240u16), (320, 240), (1, 1), (640, 480), (2, 240)]);
    let (way, period) = (draw.below(4), 1 + draw.below(40));
    let colours = [[draw.byte(), draw.byte(), draw.byte()], [draw.byte(), draw.byte(), draw.byte()]];
    let mut rgb = Vec::with_capacity(3 * usize::from(width) * usize::from(height));
    for v in 0..usize::from(height) {
        for u in 0..usize::from(width) {
            match way {
                0 => rgb.extend(draw.bytes(3)),
                1 => rgb.extend(colours[(u / period) % 2]),
                2 => rgb.extend(colours[(u / period + v / period) % 2]),
                _ => rgb.extend(colours[0]),
            }
        }
    }
    if draw.chance(0.3) {
        return png(draw, &rgb, u32::from(width), u32::from(height));
    }
    let mut bytes = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut bytes, 80);
    encoder.encode(&rgb, width, height, jpeg_encoder::ColorType::Rgb).expect("encodes");
    if draw.chance(0.3) {
        // The frame's head says another size.
        if let Some(at) = bytes.windows(2).position(|marker| marker == [0xff, 0xc0]) {
            let size: u16 = *draw.one_of(&[0, 1, 239, 241, 4096, 16_384, 65_535]);
            bytes[at + 5..at + 7].copy_from_slice(&size.to_be_bytes());
            if draw.chance(0.7) {
                bytes[at + 7..at + 9].copy_from_slice(&size.to_be_bytes());
            }
        }
    }
    bytes
}

/// Its head may say another size, with a right checksum.
fn png(draw: &mut Draw, rgb: &[u8], width: u32, height: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    image::ImageEncoder::write_image(encoder, rgb, width, height, image::ExtendedColorType::Rgb8).expect("encodes");
    if draw.chance(0.5) {
        let size: u32 = *draw.one_of(&[0, 1, 4096, 16_384, 65_535, 0x7fff_ffff, 0xffff_ffff]);
        bytes[16..20].copy_from_slice(&size.to_be_bytes());
        if draw.chance(0.7) {
            bytes[20..24].copy_from_slice(&size.to_be_bytes());
        }
        let checksum = crc32fast::hash(&bytes[12..29]).to_be_bytes();
        bytes[29..33].copy_from_slice(&checksum);
    }
    bytes
}
