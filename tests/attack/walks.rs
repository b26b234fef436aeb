//! The sound logs that are damaged: short walks, rendered, with their truth.

use std::cell::{OnceCell, RefCell, RefMut};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use realitysim::config::Settings;
use realitysim::database;
use realitysim::log_input::scene_source::{SceneSource, parse};
use realitysim::ros2::LogMessage;
use realitysim::ros2::messages::PoseStamped;
use realitysim::tagging::{ReplayOptions, ReplayReport, replay};

use crate::kinds::orders::Recorder;
use crate::kinds::service::Served;
use crate::support::{LENS, TRUTH, decode_all, own_log};

/// True places of the camera, by the stamp of the frame.
pub type Truth = BTreeMap<i64, [f64; 3]>;

pub struct Walk {
    pub name: &'static str,
    pub messages: Vec<LogMessage>,
    pub truth: Truth,
}

/// Of one process.
pub struct Walks {
    pub all: Vec<Walk>,
    folder: PathBuf,
    captures: OnceCell<PathBuf>,
    database: OnceCell<PathBuf>,
    service: RefCell<Option<Served>>,
    recorder: RefCell<Option<Recorder>>,
}

pub const SCENE: &str = include_str!("../replay/scene.toml");
/// The head turns while the robot walks: joints and transforms that change.
const HEAD: &str = "\n[[effect]]\nkind = \"head_motion\"\npan_amplitude_deg = 20.0\npan_period_s = 2.0\ntilt_amplitude_deg = 5.0\n\
                    tilt_period_s = 1.3\nencoder_noise_deg = 0.05\n";

impl Walks {
    /// In this folder the lens is put.
    pub fn rendered(folder: &Path) -> Self {
        let lens = folder.join("lens.toml");
        fs::write(&lens, LENS).expect("the folder can be written");
        // Ten frames.
        let scene = SCENE.replace("\"lens.toml\"", &format!("{lens:?}")).replace("[-1.1, 0.3]", "[-1.78, 0.15]");
        let unknown: String = scene.lines().filter(|line| !line.starts_with("initial_pose")).map(with_end).collect();
        // Behind what moves the robot.
        let odometry = "[[effect]]\nkind = \"odometry_error\"";
        let turning = scene.replace(odometry, &format!("{HEAD}\n{odometry}"));
        let walks = [("walk", scene), ("turning head", turning), ("unknown start", unknown)];
        let all = walks.into_iter().map(|(name, scene)| Walk::rendered(name, &scene)).collect();
        Self {
            all,
            folder: folder.to_owned(),
            captures: OnceCell::new(),
            database: OnceCell::new(),
            service: RefCell::new(None),
            recorder: RefCell::new(None),
        }
    }

    /// With the capture of the first walk.
    pub fn captures(&self) -> &Path {
        self.captures.get_or_init(|| {
            let (log, captures) = (self.folder.join("walk.mcap"), self.folder.join("captures"));
            let _ = fs::remove_dir_all(&captures);
            fs::write(&log, self.all[0].log()).expect("the folder can be written");
            replayed(&options(log, captures.clone(), Settings::default())).expect("a sound log is replayed");
            captures
        })
    }

    /// Of that capture's images.
    pub fn database(&self) -> &Path {
        self.database.get_or_init(|| {
            let folder = self.folder.join("database");
            let _ = fs::remove_dir_all(&folder);
            let added = database::add(&folder, &[self.session()], None, Default::default(), &mut |_| ());
            added.expect("a sound capture has images");
            folder
        })
    }

    /// Of that database; another one if it has ended.
    pub fn service(&self) -> RefMut<'_, Served> {
        let database = self.database();
        let mut service = self.service.borrow_mut();
        if service.as_mut().is_none_or(Served::has_ended) {
            *service = Some(Served::of(database));
        }
        RefMut::map(service, |service| service.as_mut().expect("just started"))
    }

    /// Without a camera; another one if it has ended.
    pub fn recorder(&self) -> RefMut<'_, Recorder> {
        let mut recorder = self.recorder.borrow_mut();
        if recorder.as_mut().is_none_or(Recorder::has_ended) {
            *recorder = Some(Recorder::of(&self.folder.join("recorder")));
        }
        RefMut::map(recorder, |recorder| recorder.as_mut().expect("just started"))
    }

    /// The capture's own folder.
    pub fn session(&self) -> PathBuf {
        let entries = fs::read_dir(self.captures()).expect("captures").flatten().map(|entry| entry.path());
        entries.into_iter().find(|path| path.is_dir()).expect("a session")
    }
}

fn with_end(line: &str) -> String {
    format!("{line}\n")
}

impl Walk {
    fn rendered(name: &'static str, scene: &str) -> Self {
        let scene = parse(scene, "scene.toml").expect("a possible scene");
        let messages: Vec<LogMessage> = SceneSource::new(&scene).map(|message| message.expect("renders")).collect();
        let truth = decode_all::<PoseStamped>(&messages, TRUTH).into_iter().map(|truth| {
            let p = truth.pose.position;
            (truth.header.stamp.to_nanoseconds(), [p.x, p.y, p.z])
        });
        Self { name, truth: truth.collect(), messages }
    }

    pub fn log(&self) -> Vec<u8> {
        own_log(&self.messages)
    }
}

/// Into `captures` beside the log.
pub fn options(source: PathBuf, captures: PathBuf, settings: Settings) -> ReplayOptions {
    ReplayOptions { source, captures, settings, initial: None, threads: 1, realtime: false, warm_start: false }
}

pub fn replayed(options: &ReplayOptions) -> Result<ReplayReport, String> {
    replay(options, &mut |_, _| ()).map_err(|error| error.to_string())
}
