//! What is drawn from a seed: a scene, what goes wrong on the way, and how the agent is set.

use std::fmt;

use realitysim::config::field_names;
use realitysim::localization::random::{Purpose, Stream};

use super::fault::Fault;
use crate::replay::support::LENS;

/// A fisheye of 200 deg, and a narrow lens with a square picture.
const LENSES: [&str; 2] = [
    LENS,
    "title = \"narrow\"\nwidth = 200\nheight = 200\nfx = 110.0\nfy = 111.0\ncx = 97.0\ncy = 104.5\nmodel = \"plumb_bob\"\n\
     d = [-0.2, 0.03, 0.001, -0.001, 0.0]\n",
];

#[derive(Clone, Debug)]
pub struct Case {
    pub seed: u64,
    field: String,
    pub lens: &'static str,
    route: Vec<[f64; 2]>,
    speed_m_s: f64,
    initial_pose: bool,
    effects: Vec<String>,
    pub faults: Vec<Fault>,
    /// Lines of the config's `[filter]`.
    settings: Vec<String>,
    pub threads: usize,
}

/// Numbers of one case.
pub struct Draw(Stream);

impl Draw {
    pub fn new(seed: u64, of: u32) -> Self {
        Self(Stream::new(seed, Purpose::Start, 0, 0, of))
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        // Few digits: the case is to be read.
        ((low + (high - low) * self.0.uniform()) * 1000.0).round() / 1000.0
    }

    pub fn below(&mut self, bound: usize) -> usize {
        self.0.below(bound as u64) as usize
    }

    pub fn chance(&mut self, odds: f64) -> bool {
        self.0.uniform() < odds
    }

    pub fn one_of<'a, T>(&mut self, of: &'a [T]) -> &'a T {
        &of[self.below(of.len())]
    }
}

impl Case {
    pub fn drawn(seed: u64) -> Self {
        let draw = &mut Draw::new(seed, 0);
        let mut route = vec![[draw.between(-2.5, 2.5), draw.between(-1.5, 1.5)]];
        for _ in 0..1 + draw.below(2) {
            let [x, y] = route[route.len() - 1];
            let to = [x + draw.between(-0.7, 0.7), y + draw.between(-0.7, 0.7)];
            route.push([to[0].clamp(-2.8, 2.8), to[1].clamp(-1.8, 1.8)]);
        }
        Self {
            seed,
            field: draw.one_of(&field_names()).clone(),
            lens: LENSES[draw.below(LENSES.len())],
            speed_m_s: draw.between(0.15, 0.5),
            initial_pose: draw.chance(0.8),
            effects: effects(&mut Draw::new(seed, 1)),
            faults: Fault::drawn(&mut Draw::new(seed, 2)),
            settings: settings(&mut Draw::new(seed, 3)),
            threads: *draw.one_of(&[1, 2, 4, 7]),
            route,
        }
    }

    /// The same without one thing, the greatest first.
    pub fn shorter(&self) -> Vec<Self> {
        let mut all = Vec::new();
        if self.route.len() > 2 {
            all.push(Self { route: self.route[..2].to_vec(), ..self.clone() });
        }
        let without = |list: &[String], index: usize| -> Vec<String> {
            list.iter().enumerate().filter(|(other, _)| *other != index).map(|(_, text)| text.clone()).collect()
        };
        for index in 0..self.effects.len() {
            all.push(Self { effects: without(&self.effects, index), ..self.clone() });
        }
        for index in 0..self.faults.len() {
            let mut shorter = self.clone();
            shorter.faults.remove(index);
            all.push(shorter);
        }
        for index in 0..self.settings.len() {
            all.push(Self { settings: without(&self.settings, index), ..self.clone() });
        }
        if self.threads > 1 {
            all.push(Self { threads: 1, ..self.clone() });
        }
        all
    }

    /// `lens` is the path of its lens file.
    pub fn scene(&self, lens: &str) -> String {
        let pose = if self.initial_pose { "initial_pose = { x_m = 0.05, y_m = -0.04, yaw_deg = 2.0 }\n" } else { "" };
        let route: Vec<String> = self.route.iter().map(|[x, y]| format!("[{x:.3}, {y:.3}]")).collect();
        let effects: Vec<String> = self.effects.iter().map(|effect| format!("\n[[effect]]\n{effect}\n")).collect();
        format!(
            "[scene]\ntitle = \"Stress\"\ntask = \"Break something.\"\nseed = {}\nfield = \"{}\"\n{pose}\n\
             [camera]\nlens = \"{lens}\"\nrate_hz = 10.0\njpeg_quality = 80\ntorso_height_m = 0.38\n\
             mount_xyz_m = [0.04, 0.0, 0.11]\nmount_pitch_deg = 17.0\n\n\
             [route]\nkind = \"walk\"\nwaypoints = [{}]\nspeed_m_s = {}\nturn_deg_s = 90.0\n\n\
             [odometry]\nrate_hz = 50.0\n\n[imu]\nrate_hz = 100.0\n{}",
            self.seed,
            self.field,
            route.join(", "),
            self.speed_m_s,
            effects.concat()
        )
    }

    pub fn config(&self) -> String {
        format!("[filter]\n{}\n", self.settings.join("\n"))
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "--- scene\n{}", self.scene("tests/replay/lens.toml"))?;
        writeln!(f, "--- faults\n{:?}\n--- {} threads, config\n{}", self.faults, self.threads, self.config())
    }
}

fn effects(draw: &mut Draw) -> Vec<String> {
    let effects: [fn(&mut Draw) -> String; 20] = [
        |d| {
            format!(
                "kind = \"gait_sway\"\nroll_deg = {}\npitch_deg = {}\nlateral_m = {}\nvertical_m = {}\nstep_hz = {}",
                d.between(0.0, 20.0),
                d.between(0.0, 20.0),
                d.between(0.0, 0.1),
                d.between(0.0, 0.04),
                d.between(0.5, 5.0)
            )
        },
        |d| {
            format!(
                "kind = \"head_motion\"\npan_amplitude_deg = {}\npan_period_s = {}\ntilt_amplitude_deg = {}\n\
                 tilt_period_s = {}",
                d.between(0.0, 150.0),
                d.between(0.5, 5.0),
                d.between(0.0, 80.0),
                d.between(0.5, 5.0)
            )
        },
        |d| {
            format!(
                "kind = \"kidnapping\"\nat_s = {}\nduration_s = {}\nto_m = [{}, {}]\nto_yaw_deg = {}",
                d.between(0.2, 1.0),
                d.between(0.0, 1.0),
                d.between(-1.2, 1.2),
                d.between(-0.3, 0.3),
                d.between(-180.0, 180.0)
            )
        },
        |d| {
            format!(
                "kind = \"fall\"\nat_s = {}\ndirection = \"{}\"\nfall_s = {}\nlie_s = {}\nrise_s = 0.5\nmoved_m = [{}, 0.2]",
                d.between(0.1, 0.6),
                d.one_of(&["forwards", "backwards", "left", "right"]),
                d.between(0.2, 1.0),
                d.between(0.1, 1.0),
                d.between(-0.5, 0.5)
            )
        },
        |d| {
            format!(
                "kind = \"turf\"\nblades = {}\nglint_share = {}\npaint = {}\nragged_mm = {}",
                d.between(0.0, 1.0),
                d.between(0.0, 0.1),
                d.between(0.0, 1.0),
                d.between(0.0, 20.0)
            )
        },
        |d| format!("kind = \"worn_lines\"\nshare = {}\npatch_m = 0.5", d.between(0.0, 1.0)),
        |d| {
            let (gain, share) = (d.between(1.1, 4.0), d.between(0.1, 1.0));
            format!(
                "kind = \"sun_patches\"\ngain = {gain}\nshare = {share}\nlength_m = {}\nedge_m = 0.2",
                d.between(0.2, 10.0)
            )
        },
        |d| {
            let gain = match d.below(3) {
                0 => "{ uniform = [0.3, 2.0], per = \"frame\" }".to_owned(),
                1 => "{ uniform = [0.05, 2.0], per = \"episode\" }".to_owned(),
                _ => d.between(0.01, 3.0).to_string(),
            };
            format!("kind = \"light\"\ngain = {gain}\ncamera_gain = {}", d.between(1.0, 16.0))
        },
        |d| {
            format!(
                "kind = \"bright_window\"\nwall = \"{}\"\ncentre_m = {}\nwidth_m = 3.0\nsill_m = 0.5\nheight_m = 2.0\n\
                 brightness = {}\nglare = {}\nsun_elevation_deg = {}",
                d.one_of(&["+x", "-x", "+y", "-y"]),
                d.between(-2.0, 2.0),
                d.between(1.0, 30.0),
                d.between(0.0, 0.5),
                d.between(5.0, 60.0)
            )
        },
        |d| format!("kind = \"obstacles\"\nrandom = {}", 1 + d.below(12)),
        |d| {
            format!("kind = \"shutter\"\nexposure_ms = {}\nreadout_ms = {}", d.between(0.1, 40.0), d.between(0.1, 50.0))
        },
        |d| {
            format!(
                "kind = \"optics\"\nstray_light = {}\nlateral_colour_px = {}",
                d.between(0.01, 0.5),
                d.between(0.0, 5.0)
            )
        },
        |d| {
            format!(
                "kind = \"exposure_hunting\"\namplitude = {}\nperiod_s = {}",
                d.between(0.1, 0.8),
                d.between(0.1, 5.0)
            )
        },
        |d| {
            format!(
                "kind = \"odometry_error\"\nscale_percent = {}\nyaw_drift_deg_per_m = {}\nnoise_m_per_m = {}\n\
                 jump.at_s = 0.8\njump.x_m = {}\njump.y_m = 0.5\njump.yaw_deg = 30.0",
                d.between(-80.0, 100.0),
                d.between(-80.0, 80.0),
                d.between(0.0, 2.0),
                d.between(-100.0, 100.0)
            )
        },
        |d| {
            format!(
                "kind = \"imu_error\"\nroll_bias_deg = {}\npitch_bias_deg = {}\nnoise_deg = {}\ngyro_noise_deg_s = {}\n\
                 mount_roll_deg = {}",
                d.between(-30.0, 30.0),
                d.between(-30.0, 30.0),
                d.between(0.0, 30.0),
                d.between(0.0, 100.0),
                d.one_of(&[0.0, 0.0, 180.0])
            )
        },
        |d| {
            format!(
                "kind = \"calibration_error\"\nfocal_percent = {}\ncentre_px = [{}, 3.0]\nmount_pitch_deg = {}\nheight_m = {}",
                d.between(-5.0, 5.0),
                d.between(-10.0, 10.0),
                d.between(-10.0, 10.0),
                d.between(-0.1, 0.1)
            )
        },
        |d| {
            format!(
                "kind = \"sensor_noise\"\nread_noise_dn = {}\nshot_noise_factor = {}",
                d.between(0.0, 50.0),
                d.between(0.0, 3.0)
            )
        },
        |d| {
            let colour_filter = d.one_of(&["true", "false"]);
            format!(
                "kind = \"image_processing\"\ncolour_filter = {colour_filter}\nsharpening = {}",
                d.between(0.1, 3.0)
            )
        },
        |d| {
            let (from, lasts) = (d.between(0.1, 0.8), d.between(0.1, 1.0));
            format!("kind = \"camera_fault\"\nunplugged = {{ from_s = {from}, for_s = {lasts} }}")
        },
        |d| {
            format!(
                "kind = \"serial_noise\"\nlost_share = {}\ncorrupt_share = {}",
                d.between(0.01, 0.9),
                d.between(0.001, 0.05)
            )
        },
    ];
    let mut drawn = Vec::new();
    for effect in effects {
        if draw.chance(0.25) {
            drawn.push(effect(draw));
        }
    }
    let has = |kind: &str| drawn.iter().any(|effect: &String| effect.contains(kind));
    if !has("gait_sway") && !has("head_motion") {
        // A scene that calls for it then is refused.
        drawn.retain(|effect| !effect.contains("\"shutter\""));
    }
    drawn
}

fn settings(draw: &mut Draw) -> Vec<String> {
    let settings: [(&str, &[&str]); 13] = [
        ("particles", &["1", "2", "50", "2000"]),
        ("iterations", &["1", "2", "20"]),
        ("line_points", &["10", "2000"]),
        ("alpha", &["1e-6", "1.0", "-1000.0", "1e9"]),
        ("model", &["\"distance\""]),
        ("formula", &["\"paper\""]),
        ("motion", &["\"random_walk\""]),
        ("refinement", &["false"]),
        ("jitter_xy_m", &["0.0", "10.0"]),
        ("jitter_yaw_deg", &["0.0", "180.0"]),
        ("initial_xy_m", &["0.0", "50.0"]),
        ("image_reduction", &["1", "2", "8"]),
        ("tilt_sigma_deg", &["0.0", "45.0"]),
    ];
    let mut drawn = Vec::new();
    for (key, values) in settings {
        if draw.chance(0.25) {
            drawn.push(format!("{key} = {}", draw.one_of(values)));
        }
    }
    drawn
}
