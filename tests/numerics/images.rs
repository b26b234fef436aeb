//! Pictures that show nothing, too much, or what looks like lines and is none. Each goes through vision, filter and
//! refinement of a robot that stood and knew where, and of one that never knew; a tag may be invalid, it must not be
//! valid and wrong, and every number of it is finite (`Robot::tag` asserts both).

use realitysim::config::{Settings, load_lens};
use realitysim::geometry::Pose2;
use realitysim::localization::random::{Purpose, Stream};
use realitysim::vision::Picture;

use super::support::{FRAME_NS, Robot, resized, small_lens};

const CARPET: [u8; 3] = [40, 110, 45];
const PAINT: [u8; 3] = [225, 228, 222];

fn gray(like: &Picture, luma: impl FnMut(usize) -> u8) -> Picture {
    let count = like.width * like.height;
    Picture::from_gray(like.width, like.height, (0..count).map(luma).collect()).expect("a picture")
}

/// Six frames of it, after a second in which all was well; then all is well again.
fn survives(name: &str, picture: impl Fn(&Robot) -> Picture) {
    let lens = small_lens();
    let mut robot = Robot::at(Pose2::new(-1.2, 0.4, 0.5), &lens, &Settings::default());
    robot.settle();
    let picture_of = picture(&robot);
    for _ in 0..6 {
        robot.tag(&picture_of);
        robot.stamp_ns += FRAME_NS;
    }
    let again = (0..30).any(|_| robot.step().valid);
    assert!(again, "{name}: the lines are back, and 3 s later the pose is not");
    let mut lost = Robot::nowhere(Pose2::new(-1.2, 0.4, 0.5), &lens, &Settings::default());
    for _ in 0..2 {
        let tag = lost.tag(&picture_of);
        assert!(!tag.valid, "{name}: nobody said where the robot is, and this picture cannot");
        lost.stamp_ns += FRAME_NS;
    }
}

#[test]
fn all_black_and_all_white_pictures_say_nothing() {
    for level in [0, 255, 128] {
        survives(&format!("all {level}"), |robot| gray(&robot.view(), |_| level));
    }
}

#[test]
fn a_saturated_picture_says_nothing_wrong() {
    survives("saturated", |robot| {
        let view = robot.view();
        gray(&view, |index| (u32::from(view.luma[index]) * 6).min(255) as u8)
    });
}

#[test]
fn pure_noise_says_nothing() {
    survives("noise", |robot| {
        let mut draw = Stream::new(8, Purpose::Start, 0, 0, 0);
        gray(&robot.view(), |_| draw.below(256) as u8)
    });
}

#[test]
fn stripes_that_look_like_lines_everywhere_say_nothing_wrong() {
    for apart in [0.15, 0.3, 0.6] {
        survives(&format!("stripes every {apart} m"), |robot| {
            robot.rendered(|at| if (at.x / apart).fract().abs() < 0.05 / apart { PAINT } else { CARPET })
        });
        survives(&format!("a grid every {apart} m"), |robot| {
            let near = |x: f64| (x / apart).fract().abs() < 0.05 / apart;
            robot.rendered(|at| if near(at.x) || near(at.y) { PAINT } else { CARPET })
        });
    }
}

#[test]
fn a_single_line_is_no_reason_to_jump() {
    for (x, slope) in [(0.8, 0.0), (1.6, 0.3), (0.0, 4.0)] {
        survives("a single line", |robot| {
            robot.rendered(|at| if (at.x - x - slope * at.y).abs() < 0.025 { PAINT } else { CARPET })
        });
    }
}

#[test]
fn a_carpet_without_lines_says_nothing() {
    survives("no line", |robot| robot.rendered(|_| CARPET));
}

#[test]
fn dark_lines_on_bright_carpet_are_no_lines() {
    survives("inverted", |robot| {
        let mut view = robot.view();
        view.luma.iter_mut().for_each(|luma| *luma = 255 - *luma);
        view
    });
}

#[test]
fn a_picture_half_covered_says_what_the_other_half_says() {
    for (name, covers) in [("left", 0), ("right", 1), ("upper", 2), ("lower", 3)] {
        for level in [0, 90, 255] {
            survives(&format!("{name} half is {level}"), |robot| {
                let mut view = robot.view();
                for (index, luma) in view.luma.iter_mut().enumerate() {
                    let (u, v) = (index % view.width, index / view.width);
                    let sides = [u < view.width / 2, u >= view.width / 2, v < view.height / 2, v >= view.height / 2];
                    if sides[covers] {
                        *luma = level;
                    }
                }
                view
            });
        }
    }
}

#[test]
fn pictures_of_every_size_are_looked_at_from_one_pixel_to_4k() {
    let full = load_lens("fisheye-640").expect("a shipped lens").lens.parameters().clone();
    for (width, height) in [(1, 1), (1, 480), (640, 1), (2, 2), (3, 5), (17, 13), (641, 479), (333, 251), (3840, 2160)]
    {
        let lens = resized(&full, width, height);
        let mut robot = Robot::at(Pose2::new(-1.2, 0.4, 0.5), &lens, &Settings::default());
        if height >= 240 && width >= 320 {
            robot.settle();
        } else {
            assert!((0..3).all(|_| !robot.step().valid), "{width} x {height} pixels cannot tell");
        }
    }
}

/// Lost on a white wall, the robot was put where no line is in view, and stayed: nothing contradicted that any more.
#[test]
fn a_search_of_a_picture_without_lines_puts_the_robot_nowhere() {
    for refinement in [true, false] {
        let mut settings = Settings::default();
        settings.filter.refinement = refinement;
        let mut robot = Robot::nowhere(Pose2::new(-1.2, 0.4, 0.5), &small_lens(), &settings);
        let white = gray(&robot.view(), |_| 255);
        for _ in 0..6 {
            assert_eq!(robot.tag(&white).reason, "overexposed");
            robot.stamp_ns += FRAME_NS;
        }
        assert!((0..20).any(|_| robot.step().valid), "with lines in view it finds itself within 2 s");
    }
}
