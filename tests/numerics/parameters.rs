//! Settings at the ends of what is possible work; what is impossible is refused by name.

use realitysim::config::Settings;
use realitysim::geometry::Pose2;
use realitysim::localization::observation::reading;
use realitysim::localization::{Formula, Model};
use realitysim::ros2::messages::FrameTag;
use realitysim::vision::TableQuantity;

use super::support::{Robot, small_lens};

/// Two frames with these settings: every tag is sound, none is valid and wrong.
fn tags(change: impl Fn(&mut Settings)) -> Vec<FrameTag> {
    let mut settings = Settings::default();
    settings.filter.particles = 200;
    change(&mut settings);
    let mut robot = Robot::at(Pose2::new(-1.2, 0.4, 0.5), &small_lens(), &settings);
    (0..3).map(|_| robot.step()).collect()
}

#[test]
fn every_alpha_from_a_millionth_to_a_billion_gives_weights() {
    for alpha in [1e-6, 1e-3, 1.0, 1e3, 1e9, -1e-6, -1e9] {
        for (model, formula) in [
            (Model::Gauss, Formula::Corrected),
            (Model::Distance, Formula::Corrected),
            (Model::Gauss, Formula::Paper),
            (Model::Distance, Formula::Paper),
        ] {
            let tags = tags(|settings| {
                settings.filter.alpha = Some(alpha);
                (settings.filter.model, settings.filter.formula) = (model, formula);
            });
            let size = tags[0].effective_sample_size;
            assert!((1.0 - 1e-9..=200.0 + 1e-6).contains(&size), "{alpha} {model:?} {formula:?}: {size}");
            if alpha.abs() >= 1e9 {
                assert!(size > 199.9, "all alike: {size}");
            }
        }
    }
}

/// A library's filter takes the resampling method for that of the residuals, and the other way round; its own defaults do
/// not pass its check. Here each choice is a word of its own, and reaches the place that it names.
#[test]
fn no_two_choices_of_a_config_can_be_mixed_up() {
    let parsed = |lines: &str| Settings::parse(&format!("[filter]\n{lines}"), "robot.toml");
    for (model, formula, expected) in [
        ("gauss", "corrected", TableQuantity::Contrast),
        ("distance", "corrected", TableQuantity::Nearest),
        ("gauss", "paper", TableQuantity::Gray),
        ("distance", "paper", TableQuantity::NearestPixel),
    ] {
        let settings = parsed(&format!("formula = \"{formula}\"\nmodel = \"{model}\"")).expect("possible");
        assert_eq!(reading(settings.filter.model, settings.filter.formula), expected, "{model} {formula}");
        let swapped =
            parsed(&format!("model = \"{formula}\"\nformula = \"{model}\"")).expect_err("not each other's words");
        assert!(swapped.to_string().contains(formula), "{swapped}");
    }
    let defaults = parsed("").expect("what is left out has a default, and that is possible");
    assert_eq!(defaults.filter, Settings::default().filter);
}

#[test]
fn one_particle_and_a_million_are_sets_of_particles() {
    let one = tags(|settings| settings.filter.particles = 1);
    assert!(one.iter().all(|tag| tag.particles == 1 && tag.effective_sample_size == 1.0));
    let million = tags(|settings| {
        settings.filter.adaptive = false;
        settings.filter.particles = 1 << 20;
        settings.filter.iterations = 1;
        settings.filter.line_points = 60;
    });
    assert!(million.iter().all(|tag| tag.particles == 1 << 20 && tag.effective_sample_size > 1.0));
    assert!(million[2].valid);
}

#[test]
fn one_iteration_and_a_thousand_end() {
    for iterations in [1, 1000] {
        let tags = tags(|settings| {
            settings.filter.adaptive = false;
            settings.filter.iterations = iterations;
            settings.filter.particles = 50;
        });
        assert!(tags[2].valid && tags[2].iterations as usize == iterations);
    }
}

#[test]
fn zero_noise_and_huge_noise_leave_numbers() {
    let still = tags(|settings| {
        let f = &mut settings.filter;
        (f.initial_xy_m, f.initial_yaw_deg, f.jitter_xy_m, f.jitter_yaw_deg) = (0.0, 0.0, 0.0, 0.0);
        f.tilt_sigma_deg = 0.0;
        let m = &mut settings.motion;
        (m.distance_share, m.turn_share, m.turn_rad_per_m) = (0.0, 0.0, 0.0);
        (m.drift_m_per_sqrt_s, m.drift_rad_per_sqrt_s) = (0.0, 0.0);
    });
    assert!(still.iter().all(|tag| tag.spread_m < 1e-9), "{}", still[0].spread_m);
    for refinement in [true, false] {
        tags(|settings| {
            let f = &mut settings.filter;
            (f.initial_xy_m, f.initial_yaw_deg, f.jitter_xy_m, f.jitter_yaw_deg) = (100.0, 360.0, 10.0, 180.0);
            (f.jitter_shrink, f.tilt_sigma_deg, f.refinement) = (1.0, 45.0, refinement);
            let m = &mut settings.motion;
            (m.distance_share, m.turn_share, m.turn_rad_per_m) = (100.0, 100.0, 100.0);
            (m.drift_m_per_sqrt_s, m.drift_rad_per_sqrt_s) = (100.0, 100.0);
        });
    }
}

/// Every number of the config, in turn: what it cannot be is refused, with the key's name.
#[test]
fn impossible_numbers_are_refused_by_name() {
    let defaults = toml::Table::try_from(Settings::default()).expect("a table");
    let mut tried = 0;
    for (section, keys) in defaults.iter().filter_map(|(section, value)| Some((section, value.as_table()?))) {
        for (key, value) in keys {
            let bad: &[&str] = match value {
                toml::Value::Float(_) => &["nan", "inf", "-inf", "-1.0", "1e30"],
                toml::Value::Integer(_) if key != "seed" => &["-1", "9000000000000000000"],
                _ => continue,
            };
            // A delay may be negative: a stamp after the exposure.
            let signed = key == "delay_ms";
            for bad in bad.iter().filter(|bad| !(signed && **bad == "-1.0")) {
                let said = Settings::parse(&format!("[{section}]\n{key} = {bad}\n"), "robot.toml");
                let said = said.expect_err(&format!("{section}.{key} = {bad} is impossible")).to_string();
                assert!(said.contains(key.as_str()), "{section}.{key} = {bad}: {said}");
                tried += 1;
            }
        }
    }
    for text in ["alpha = 0.0", "alpha = nan", "alpha = 1e13", "particles = 0", "iterations = 0"] {
        let said = Settings::parse(&format!("[filter]\n{text}\n"), "robot.toml").expect_err(text).to_string();
        assert!(said.contains(text.split(' ').next().expect("a key")), "{text}: {said}");
        tried += 1;
    }
    assert!(tried > 100, "{tried}");
}
