//! OpenCV in a Python of its own, asked once a round.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use realitysim::views::Raster;

pub struct OpenCv {
    child: Child,
    ask: ChildStdin,
    answers: BufReader<ChildStdout>,
    _folder: tempfile::TempDir,
}

/// One thread, as ours.
const SCRIPT: &str = "
import sys, time, numpy, cv2
cv2.setNumThreads(1)
u, v = (numpy.fromfile(sys.argv[1] + name, numpy.float32).reshape(480, 640) for name in ('/u', '/v'))
image = numpy.fromfile(sys.argv[1] + '/rgb', numpy.uint8).reshape(480, 640, 3)
for _ in range(5):
    cv2.remap(image, u, v, cv2.INTER_LINEAR)
print('ready', flush=True)
for line in sys.stdin:
    started = time.perf_counter()
    cv2.remap(image, u, v, cv2.INTER_LINEAR)
    print(1e3 * (time.perf_counter() - started), flush=True)
";

impl OpenCv {
    /// `None` where there is no OpenCV.
    pub fn start([u, v]: &[Vec<f32>; 2], image: &Raster) -> Option<Self> {
        let python = std::env::var_os("REALITYSIM_PYTHON")?;
        let folder = tempfile::tempdir().ok()?;
        let bytes = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        for (name, content) in [("u", bytes(u)), ("v", bytes(v)), ("rgb", image.to_rgb())] {
            std::fs::write(folder.path().join(name), content).ok()?;
        }
        let mut command = Command::new(python);
        command
            .args(["-c", SCRIPT])
            .arg(folder.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::null());
        let mut child = command.spawn().ok()?;
        let (ask, mut answers) = (child.stdin.take()?, BufReader::new(child.stdout.take()?));
        let mut line = String::new();
        answers.read_line(&mut line).ok()?;
        (line.trim() == "ready").then_some(Self { child, ask, answers, _folder: folder })
    }

    /// Milliseconds of one.
    pub fn remap(&mut self) -> f64 {
        self.ask.write_all(b"\n").expect("it listens");
        let mut line = String::new();
        self.answers.read_line(&mut line).expect("it answers");
        line.trim().parse().expect("milliseconds")
    }
}

impl Drop for OpenCv {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
