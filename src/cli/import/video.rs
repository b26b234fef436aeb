//! Frames of a video as JPEGs, by ffmpeg.

use std::fs::File;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Command, Stdio};
use std::thread::{self, JoinHandle};

use anyhow::{Context, bail};

use crate::log_input::decode::MAX_IMAGE_FILE_BYTES;

/// First bytes of a file by which a video is told.
const START_BYTES: u64 = 12;
/// Most bytes of ffmpeg's complaints that are kept.
const MAX_COMPLAINT_BYTES: u64 = 4096;

/// Whether a file is a video: MP4 or MOV, AVI, Matroska or WebM.
pub(in crate::cli) fn is_video(file: File) -> bool {
    let mut start = Vec::new();
    let read = file.take(START_BYTES).read_to_end(&mut start);
    let has = |at: usize, magic: &[u8]| start.get(at..).is_some_and(|rest| rest.starts_with(magic));
    read.is_ok() && (has(4, b"ftyp") || has(8, b"AVI ") || has(0, b"\x1a\x45\xdf\xa3"))
}

/// Reads the frames of a video one by one. ffmpeg waits while the pipe is full, so the memory is bounded by one frame.
pub(in crate::cli) struct FrameReader {
    ffmpeg: Child,
    /// `None` once it has ended.
    frames: Option<BufReader<ChildStdout>>,
    /// Reads what ffmpeg complains of, since a full pipe would stop it.
    complaint: Option<JoinHandle<String>>,
    video: String,
}

impl FrameReader {
    /// Starts ffmpeg on a file.
    pub(in crate::cli) fn start(video: &Path) -> anyhow::Result<Self> {
        // An absolute path is no option and names no protocol.
        let path = std::path::absolute(video)?;
        let mut input = std::ffi::OsString::from("file:");
        input.push(&path);
        let mut command = Command::new("ffmpeg");
        command.args(["-nostdin", "-v", "error", "-protocol_whitelist", "file", "-noautorotate", "-i"]).arg(input);
        // Each frame once, as it is stored: no frame is repeated or left out to keep a rate.
        command.args([
            "-map",
            "0:v:0",
            "-fps_mode",
            "passthrough",
            "-c:v",
            "mjpeg",
            "-q:v",
            "2",
            "-f",
            "image2pipe",
            "pipe:1",
        ]);
        let started = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
        let mut ffmpeg = started.map_err(|error| match error.kind() {
            ErrorKind::NotFound => anyhow::anyhow!(
                "{}: the frames of a video are taken with ffmpeg (5.1 or later), which is not installed: install it, or make pictures of \
                 the video elsewhere and name their folder",
                video.display()
            ),
            _ => anyhow::Error::new(error).context("ffmpeg cannot be started"),
        })?;
        let frames = ffmpeg.stdout.take().map(|pipe| BufReader::with_capacity(1 << 16, pipe));
        let complaint = ffmpeg.stderr.take().map(|pipe| thread::spawn(move || start_of(pipe)));
        Ok(Self { ffmpeg, frames, complaint, video: video.display().to_string() })
    }

    /// The next frame as a JPEG; `None` at the end of the video. What ffmpeg complained of by then goes to `complain`.
    pub(in crate::cli) fn next_frame(&mut self, complain: &mut dyn FnMut(String)) -> anyhow::Result<Option<Vec<u8>>> {
        let Some(frames) = &mut self.frames else { return Ok(None) };
        match read_jpeg(frames) {
            Ok(Some(frame)) => Ok(Some(frame)),
            Ok(None) => {
                self.frames = None;
                let complaint = self.end()?;
                if !complaint.is_empty() {
                    complain(format!("ffmpeg says: {complaint}"));
                }
                Ok(None)
            }
            Err(error) => {
                // If ffmpeg has failed, it says why.
                self.frames = None;
                self.end()?;
                Err(error.context(format!("{}: ffmpeg's frames cannot be read", self.video)))
            }
        }
    }

    /// Waits for ffmpeg, whose output is closed, and returns what it complained of. If it failed that is the error.
    fn end(&mut self) -> anyhow::Result<String> {
        let status = self.ffmpeg.wait()?;
        let complaint = self.complaint.take().and_then(|reader| reader.join().ok()).unwrap_or_default();
        if !status.success() {
            bail!("{}: ffmpeg failed: {complaint}", self.video);
        }
        Ok(complaint)
    }
}

/// The start of what a pipe has. The rest is read and left out.
fn start_of(mut pipe: ChildStderr) -> String {
    let mut start = Vec::new();
    let _ = pipe.by_ref().take(MAX_COMPLAINT_BYTES).read_to_end(&mut start);
    let _ = std::io::copy(&mut pipe, &mut std::io::sink());
    String::from_utf8_lossy(&start).trim().to_owned()
}

impl Drop for FrameReader {
    /// Ends ffmpeg where the import ended before the video.
    fn drop(&mut self) {
        let _ = self.ffmpeg.kill();
        let _ = self.ffmpeg.wait();
    }
}

/// Reads one JPEG of several that follow each other; `None` at the end.
///
/// Markers are followed as ITU-T T.81, annex B, has them: segments by their length, the coded pixels up to a marker that is neither
/// a stuffed byte nor a restart.
fn read_jpeg(input: &mut impl Read) -> anyhow::Result<Option<Vec<u8>>> {
    let mut frame = Vec::new();
    let mut byte = [0u8; 1];
    if input.read(&mut byte)? == 0 {
        return Ok(None);
    }
    frame.push(byte[0]);
    let mut next = |frame: &mut Vec<u8>| -> anyhow::Result<u8> {
        if frame.len() as u64 >= MAX_IMAGE_FILE_BYTES {
            bail!("a frame is larger than {MAX_IMAGE_FILE_BYTES} bytes");
        }
        let mut byte = [0u8; 1];
        input.read_exact(&mut byte).context("a frame is cut short")?;
        frame.push(byte[0]);
        Ok(byte[0])
    };
    if frame[0] != 0xff || next(&mut frame)? != 0xd8 {
        bail!("no JPEG begins where one should");
    }
    let mut is_scan = false;
    loop {
        let byte = next(&mut frame)?;
        if byte != 0xff {
            if is_scan {
                continue;
            }
            bail!("no marker where one should be");
        }
        let mut marker = next(&mut frame)?;
        while marker == 0xff {
            marker = next(&mut frame)?;
        }
        match marker {
            0xd9 => return Ok(Some(frame)),
            0x00 | 0xd0..=0xd7 if is_scan => {}
            _ => {
                let length = u16::from_be_bytes([next(&mut frame)?, next(&mut frame)?]);
                if length < 2 {
                    bail!("a segment has the length {length}");
                }
                for _ in 2..length {
                    next(&mut frame)?;
                }
                is_scan = marker == 0xda;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jpeg(shade: u8) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pixels: Vec<u8> = (0..24 * 16).map(|i| (i * 37 % 251) as u8 ^ shade).collect();
        let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 95);
        encoder.set_restart_interval(2);
        encoder.encode(&pixels, 24, 16, jpeg_encoder::ColorType::Luma).expect("encoded");
        bytes
    }

    #[test]
    fn frames_that_follow_each_other_are_taken_apart() {
        let frames: Vec<Vec<u8>> = [0, 90, 255].map(jpeg).to_vec();
        let stream = frames.concat();
        let mut input = stream.as_slice();
        for frame in &frames {
            assert_eq!(read_jpeg(&mut input).expect("sound").as_ref(), Some(frame));
        }
        assert_eq!(read_jpeg(&mut input).expect("the end"), None);
    }

    #[test]
    fn a_frame_that_is_cut_short_is_an_error() {
        let frame = jpeg(7);
        for length in 1..frame.len() {
            assert!(read_jpeg(&mut &frame[..length]).is_err(), "{length}");
        }
    }
}
