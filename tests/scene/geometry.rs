//! Painted lines are where the lens says, to a small part of a pixel, and as strong as they are wide.
//!
//! Two fields that differ in one line only give two images whose difference is that line, texture or not.

use glam::{DVec2, DVec3};
use realitysim::geometry::{Euler, FieldDimensions, Isometry, Lens};
use realitysim::scene::{Renderer, Scene, SceneFile};

use super::common::{STRAIGHT, fisheye_640, kid_2009};

/// One line, alone.
struct Line {
    with: Renderer,
    without: Renderer,
    lens: Lens,
    /// Point at fraction t along the line, at an offset across it in metres.
    at: fn(f64, f64) -> DVec2,
}

/// What columns that cross the line say, against what the lens says about its edges.
#[derive(Debug, Default)]
struct Report {
    columns: usize,
    mean_error_px: f64,
    rms_error_px: f64,
    /// Of the centre line itself; differs from the middle between the edges by perspective.
    mean_error_of_centre_px: f64,
    mean_width_px: f64,
    /// Painted area found, over the area that the edges enclose.
    strength: f64,
}

fn line(with: FieldDimensions, without: FieldDimensions, at: fn(f64, f64) -> DVec2) -> Line {
    let renderer = |field| {
        let file = SceneFile::from_toml(STRAIGHT).expect("readable");
        Renderer::new(&Scene::build(file, field, fisheye_640()).expect("possible"))
    };
    Line { with: renderer(with), without: renderer(without), lens: Lens::new(fisheye_640()).expect("good"), at }
}

fn goal_area_front() -> Line {
    let without = FieldDimensions { goal_area: None, ..kid_2009() };
    line(kid_2009(), without, |t, across| DVec2::new(2.4 + across, 0.6 - 1.2 * t))
}

/// The half of the centre circle that is farther from a camera in the west, and the nearer one.
fn circle(far: bool) -> Line {
    let at: fn(f64, f64) -> DVec2 = if far {
        |t, across| DVec2::from_angle(0.7 - 1.4 * t) * (0.6 + across)
    } else {
        |t, across| -DVec2::from_angle(1.4 * t - 0.7) * (0.6 - across)
    };
    line(kid_2009(), FieldDimensions { centre_circle_diameter_m: 0.0, ..kid_2009() }, at)
}

/// The arc at the corner of positive x and y, seen from the field.
fn corner_arc() -> Line {
    let with = FieldDimensions { corner_arc_radius_m: Some(0.6), ..kid_2009() };
    let at = |t: f64, across: f64| DVec2::new(3.0, 2.0) - DVec2::from_angle(0.3 + t) * (0.6 - across);
    line(with, kid_2009(), at)
}

fn camera(x: f64, y: f64, yaw: f64, pitch: f64, roll: f64) -> Isometry {
    Isometry::from_euler(Euler { yaw, pitch, roll }, DVec3::new(x, y, 0.49))
}

impl Line {
    /// Columns at which the line runs rather flat.
    fn report(&self, pose: &Isometry) -> Report {
        let [mut with, mut without] = [Vec::new(), Vec::new()];
        self.with.render_clean(pose, 0, &mut with);
        self.without.render_clean(pose, 0, &mut without);
        let optical_from_map = (*pose * Isometry::link_from_optical()).inverse();
        let pixel = |t: f64, across: f64| {
            self.lens.project(optical_from_map.transform_point((self.at)(t, across).extend(0.0))).expect("in view")
        };
        let mut report = Report::default();
        let ends = [pixel(0.0, 0.0).x, pixel(1.0, 0.0).x];
        assert!(ends[0] < ends[1], "the line runs from left to right: {ends:?}");
        for column in (ends[0] + 1.0).max(0.0) as usize..(ends[1] - 1.0).min(639.0) as usize {
            let row_of = |across| {
                let (mut low, mut high) = (-0.05, 1.05);
                for _ in 0..50 {
                    let middle = (low + high) / 2.0;
                    if pixel(middle, across).x < column as f64 { low = middle } else { high = middle }
                }
                pixel(low, across).y
            };
            let (upper, lower, centre) = (row_of(0.025), row_of(-0.025), row_of(0.0));
            if !(4.0..475.0).contains(&upper) || !(4.0..475.0).contains(&lower) {
                continue;
            }
            let (mut area, mut moment) = (0.0, 0.0);
            for row in (upper - 4.0) as usize..(lower + 4.0) as usize + 1 {
                let at = (row * 640 + column) * 3;
                let light = |image: &[u8]| f64::from(image[at]) + f64::from(image[at + 2]);
                let share = (light(&with) - light(&without)) / (444.0 - light(&without));
                area += share;
                moment += share * row as f64;
            }
            let error = moment / area - (upper + lower) / 2.0;
            report.columns += 1;
            report.mean_error_px += error;
            report.rms_error_px += error * error;
            report.mean_error_of_centre_px += moment / area - centre;
            report.mean_width_px += lower - upper;
            report.strength += area;
        }
        let n = report.columns as f64;
        report.strength /= report.mean_width_px;
        report.mean_width_px /= n;
        report.mean_error_px /= n;
        report.mean_error_of_centre_px /= n;
        report.rms_error_px = (report.rms_error_px / n).sqrt();
        report
    }
}

#[test]
fn a_straight_line_is_where_the_lens_says() {
    let line = goal_area_front();
    for pose in [
        camera(1.7, 0.0, 0.0, 0.3, 0.0),
        camera(1.0, 0.3, 0.1, 0.25, 0.05),
        camera(0.0, -0.5, -0.1, 0.3, -0.04),
        camera(-1.0, 0.2, 0.2, 0.3, 0.03),
        camera(-2.0, 1.0, -0.3, 0.35, 0.0),
        camera(-2.9, 0.1, 0.0, 0.3, 0.02),
        camera(-2.9, 0.13, 0.0, 0.31, 0.0),
    ] {
        let report = line.report(&pose);
        assert!(report.columns > 30, "{report:?}");
        assert!(report.mean_error_px.abs() < 0.02, "{report:?}");
        assert!(report.rms_error_px < 0.03, "{report:?}");
        assert!(report.mean_width_px > 1.5 || report.mean_error_of_centre_px.abs() < 0.02, "{report:?}");
    }
}

#[test]
fn a_line_thinner_than_a_pixel_is_painted_in_proportion() {
    let line = goal_area_front();
    let (mut widest, mut thinnest) = (0f64, f64::INFINITY);
    for x in [-0.3, -0.9, -1.5, -2.1, -2.9] {
        let report = line.report(&camera(x, 0.1, 0.0, 0.3, 0.02));
        assert!((report.strength - 1.0).abs() < 0.04, "{report:?}");
        widest = widest.max(report.mean_width_px);
        thinnest = thinnest.min(report.mean_width_px);
    }
    assert!(widest > 0.5 && thinnest < 0.25, "{widest} {thinnest}");
}

#[test]
fn a_circle_is_where_the_lens_says() {
    for far in [false, true] {
        let line = circle(far);
        for pose in [
            camera(-1.3, 0.0, 0.0, 0.3, 0.0),
            camera(-2.0, 0.2, -0.1, 0.3, 0.03),
            camera(-2.9, 0.1, 0.05, 0.3, 0.0),
            camera(-3.6, -0.2, 0.0, 0.3, -0.02),
        ] {
            let report = line.report(&pose);
            assert!(report.columns > 30, "{report:?}");
            assert!(report.mean_error_px.abs() < 0.02, "{report:?}");
            assert!(report.rms_error_px < 0.04, "{report:?}");
            assert!((report.strength - 1.0).abs() < 0.03, "{report:?}");
        }
    }
}

#[test]
fn a_corner_arc_is_where_the_lens_says_and_ends_at_the_lines() {
    let arc = corner_arc();
    for pose in [
        camera(1.6, 0.7, 0.75, 0.3, 0.0),
        camera(1.0, 0.2, 0.7, 0.3, 0.02),
        camera(0.2, -0.6, 0.8, 0.25, -0.03),
        camera(1.9, 1.2, 0.7, 0.4, 0.0),
    ] {
        let report = arc.report(&pose);
        assert!(report.columns > 30, "{report:?}");
        assert!(report.mean_error_px.abs() < 0.02, "{report:?}");
        assert!(report.rms_error_px < 0.04, "{report:?}");
        assert!((report.strength - 1.0).abs() < 0.03, "{report:?}");
    }
    // Seen from outside of the field, nothing differs beyond the corner's lines.
    let pose = camera(3.4, 2.9, -2.1, 0.5, 0.0);
    let [mut with, mut without] = [Vec::new(), Vec::new()];
    arc.with.render_clean(&pose, 0, &mut with);
    arc.without.render_clean(&pose, 0, &mut without);
    let map_from_optical = pose * Isometry::link_from_optical();
    let mut inside = 0;
    for at in (0..640 * 480).filter(|at| with[3 * at..3 * at + 3] != without[3 * at..3 * at + 3]) {
        let pixel = DVec2::new((at % 640) as f64, (at / 640) as f64);
        let ray = map_from_optical.transform_vector(arc.lens.unproject(pixel).expect("in view"));
        assert!(ray.z < 0.0, "{pixel}");
        let ground = (pose.translation - ray * (pose.translation.z / ray.z)).truncate();
        // The arcs of the other corners are seen too, farther away.
        if ground.distance(DVec2::new(3.0, 2.0)) < 2.0 {
            assert!(ground.x < 3.03 && ground.y < 2.03 && ground.x > 2.3 && ground.y > 1.3, "{pixel} {ground}");
            inside += 1;
        }
    }
    assert!(inside > 100, "{inside}");
}

#[test]
fn nothing_is_black_but_the_corners_that_the_lens_does_not_see() {
    let line = goal_area_front();
    let lens = &line.lens;
    let mut pixels = Vec::new();
    for pose in [camera(-2.0, 0.0, 0.3, 0.3, 0.0), camera(3.0, 2.0, 2.0, -0.4, 0.3), camera(0.0, 0.0, 0.0, 1.5, 0.0)] {
        line.with.render_clean(&pose, 0, &mut pixels);
        for (at, pixel) in pixels.chunks_exact(3).enumerate() {
            let (column, row) = (at % 640, at / 640);
            let seen = lens.unproject(DVec2::new(column as f64, row as f64)).is_some();
            assert_eq!(pixel != [0, 0, 0], seen, "{column} {row} {pixel:?}");
        }
    }
}
