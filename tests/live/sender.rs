//! The example of docs/reference/formats.md, as it stands there: a team's own process that shares its camera with the recorder.

use std::process::Command;

use realitysim::devices::camera::{CameraOptions, Capture, CaptureEvent, CaptureRules, SocketCamera};
use realitysim::devices::host_clock::monotonic_ns;

use crate::replay::support::{IMAGE, on, walk};

fn python() -> Option<String> {
    let python = std::env::var("REALITYSIM_PYTHON").ok();
    assert!(python.is_some() || std::env::var("CI").is_err(), "REALITYSIM_PYTHON is not set: `./dev test` sets it");
    python
}

#[test]
fn ten_lines_of_python_are_a_camera() {
    let Some(python) = python() else { return };
    let room = tempfile::tempdir().expect("a folder");
    let images: Vec<Vec<u8>> = on(&walk().messages, IMAGE)
        .take(5)
        .map(|m| realitysim::ros2::messages::CompressedImageView::decode(&m.data).expect("an image").data.to_vec())
        .collect();
    for (number, image) in images.iter().enumerate() {
        std::fs::write(room.path().join(format!("{number}.jpg")), image).expect("written");
    }
    let text = std::fs::read_to_string("docs/reference/formats.md").expect("docs");
    let (_, example) = text.split_once("```python\nimport socket, struct, time\n").expect("the example");
    let (example, _) = example.split_once("```").expect("its end");
    let socket = room.path().join("camera.sock");
    // Only what it has no way to know is put in: its frames, and where the recorder listens here.
    let program = format!(
        "import socket, struct, time\nframes = lambda: (open(f'{{n}}.jpg', 'rb').read() for n in range({}))\n{}",
        images.len(),
        example.replace("/run/realitysim/camera.sock", socket.to_str().expect("a name"))
    );
    let options = CameraOptions {
        device: format!("unix:{}", socket.display()),
        width: 320,
        height: 240,
        format: None,
        rate_hz: 30.0,
        controls: Default::default(),
    };
    let mut capture = Capture::new(SocketCamera::default(), CaptureRules { options, max_rate_hz: None });
    capture.step(monotonic_ns, |_| {});
    let mut sender = Command::new(python).args(["-c", &program]).current_dir(room.path()).spawn().expect("Python");
    let (mut frames, mut others) = (Vec::new(), 0);
    let began = std::time::Instant::now();
    while frames.len() as u64 + others < images.len() as u64 && began.elapsed().as_secs() < 60 {
        capture.step(monotonic_ns, |event| match event {
            CaptureEvent::Frame(frame) => frames.push(frame),
            CaptureEvent::Dropped(_, count) => others += count,
            _ => {}
        });
    }
    assert!(sender.wait().expect("ended").success());
    assert_eq!(frames.len() as u64 + others, images.len() as u64, "each is there or counted");
    for frame in &frames {
        assert!(images[frame.sequence as usize] == frame.data, "byte for byte");
        assert!((0..5_000_000_000).contains(&(monotonic_ns() - frame.stamp_ns)), "its own stamp");
    }
}
