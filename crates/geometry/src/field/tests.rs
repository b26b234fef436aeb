use super::*;
use proptest::prelude::*;

/// The 6 x 4 m field of the paper.
fn kid_size_2013() -> FieldDimensions {
    FieldDimensions {
        title: "test".into(),
        length_m: 6.0,
        width_m: 4.0,
        line_width_m: 0.05,
        border_strip_m: 0.7,
        centre_circle_diameter_m: 1.2,
        corner_arc_radius_m: None,
        goal_area: Some(Area { depth_m: 0.6, width_m: 2.2 }),
        penalty_area: None,
        penalty_mark_from_goal_line_m: Some(1.8),
        mark_size_m: 0.1,
        centre_mark: false,
        goal: None,
    }
}

#[test]
fn points_lie_on_lines_evenly() {
    let field = Field::new(kid_size_2013()).expect("a good field");
    let points = field.points(350);
    assert!((340..=365).contains(&points.len()), "{}", points.len());
    for point in &points {
        assert!(field.distance_to_centre_line(point.position) < 1e-12);
        assert!((point.normal.length() - 1.0).abs() < 1e-12);
        let off = point.position + point.normal * 0.004;
        // Where lines cross, another line may be nearer.
        assert!(field.distance_to_centre_line(off) < 0.004 + 1e-12);
    }
}

#[test]
fn corners_are_painted_full_and_free_ends_are_not_longer() {
    let field = Field::new(kid_size_2013()).expect("a good field");
    let ends: Vec<(DVec2, DVec2)> = field
        .painted_strokes()
        .iter()
        .filter_map(|stroke| match *stroke {
            Stroke::Segment { from, to } => Some((from, to)),
            Stroke::Circle { .. } | Stroke::Quarter { .. } => None,
        })
        .collect();
    assert!(ends.contains(&(DVec2::new(-3.025, 2.0), DVec2::new(3.025, 2.0))), "touchline: {ends:?}");
    assert!(ends.contains(&(DVec2::new(-1.25, 0.0), DVec2::new(-1.15, 0.0))), "penalty mark: {ends:?}");
}

/// A field with everything that can be painted.
fn with_corner_arcs(radius_m: f64) -> Field {
    let penalty_area = Some(Area { depth_m: 1.2, width_m: 2.8 });
    let corner_arc_radius_m = Some(radius_m);
    Field::new(FieldDimensions { penalty_area, corner_arc_radius_m, ..kid_size_2013() }).expect("a good field")
}

#[test]
fn corner_arcs_lie_at_their_radius_inside_the_field() {
    let field = with_corner_arcs(0.5);
    let arcs: Vec<&Stroke> = field.strokes().iter().filter(|s| matches!(s, Stroke::Quarter { .. })).collect();
    assert_eq!(arcs.len(), 4);
    for arc in arcs {
        for point in arc.points(0.02) {
            let corner = DVec2::new(3.0, 2.0) * point.position.signum();
            assert!((point.position.distance(corner) - 0.5).abs() < 1e-12, "{point:?}");
            assert!(point.position.abs().cmplt(DVec2::new(3.0, 2.0)).all(), "{point:?}");
            assert!((point.normal.perp_dot(point.position - corner)).abs() < 1e-12, "{point:?}");
        }
        assert!((arc.length() - 0.5 * FRAC_PI_2).abs() < 1e-12);
    }
}

/// The oracle is the nearest of many points.
#[test]
fn the_distance_to_an_arc_is_that_to_its_nearest_point() {
    let arc = Stroke::Quarter { centre: DVec2::new(3.0, -2.0), radius: 0.5, side: DVec2::new(-1.0, 1.0) };
    let points = arc.points(0.0005);
    for index in 0..400 {
        let at = DVec2::new(2.0 + 0.1 * f64::from(index % 20), -3.0 + 0.1 * f64::from(index / 20));
        let nearest = points.iter().map(|point| point.position.distance(at)).fold(f64::INFINITY, f64::min);
        assert!((arc.distance(at) - nearest).abs() < 3e-4, "{at}: {} {nearest}", arc.distance(at));
    }
}

#[test]
fn a_field_of_another_size_keeps_its_areas_at_the_goal_lines() {
    let of_size = |size_m| Field::new(kid_size_2013().of_size(size_m));
    let field = of_size([5.9, 4.02]).expect("a good field");
    for at in [(2.95, 1.0), (-1.0, 2.01), (2.35, 0.5), (2.6, -1.1), (1.15, 0.0), (0.6, 0.0)] {
        let off = field.distance_to_centre_line(at.into());
        assert!(off < 1e-12, "{at:?}: {off}");
    }
    assert_eq!(of_size([5.9, 2.1]).expect_err("too narrow").key, "goal_area.width_m");
    assert_eq!(of_size([1.1, 4.0]).expect_err("too short").key, "centre_circle_diameter_m");
}

#[test]
fn the_field_looks_the_same_from_both_goals() {
    let field = Field::new(kid_size_2013()).expect("a good field");
    for field in [field, with_corner_arcs(0.4)] {
        for FieldPoint { position, .. } in field.points(200) {
            for mirrored in [-position, position * DVec2::new(1.0, -1.0), position * DVec2::new(-1.0, 1.0)] {
                assert!(field.distance_to_centre_line(mirrored) < 1e-12);
            }
        }
    }
}

#[test]
fn lines_move_with_the_size_of_the_field_as_a_field_of_that_size_has_them() {
    let field = Field::new(kid_size_2013()).expect("a field");
    let derivative = SizeDerivative::new(&field);
    let larger = Field::new(kid_size_2013().of_size([6.2, 4.1])).expect("a field");
    for point in field.points(400) {
        let [longer, wider] = derivative.at(point.position);
        let moved = point.position + longer * 0.2 + wider * 0.1;
        assert!(larger.distance_to_centre_line(moved) < 1e-9, "{point:?}");
    }
}

proptest! {
    #[test]
    fn a_field_of_any_size_with_arcs_is_the_same_in_every_mirror(
        length_m in 4.0..30.0f64, width_m in 3.6..20.0f64, radius in 0.05..0.4f64, line_width_m in 0.03..0.15f64
    ) {
        let dimensions = with_corner_arcs(radius).dimensions().clone().of_size([length_m, width_m]);
        let field = Field::new(FieldDimensions { line_width_m, ..dimensions }).expect("a good field");
        for FieldPoint { position, normal, .. } in field.points(300) {
            prop_assert!((normal.length() - 1.0).abs() < 1e-12);
            for signs in [DVec2::new(1.0, 1.0), DVec2::new(1.0, -1.0), DVec2::new(-1.0, 1.0), DVec2::new(-1.0, -1.0)] {
                let off = field.distance_to_centre_line(position * signs);
                prop_assert!(off < 1e-12, "{position} {off}");
            }
        }
    }
}

#[test]
fn an_impossible_field_names_its_key() {
    let error = Field::new(FieldDimensions { width_m: -4.0, ..kid_size_2013() }).expect_err("refused");
    assert!(error.to_string().starts_with("width_m is -4"));
    let area = Some(Area { depth_m: 4.0, width_m: 2.0 });
    let error = Field::new(FieldDimensions { goal_area: area, ..kid_size_2013() }).expect_err("refused");
    assert_eq!(error.key, "goal_area.depth_m");
    for radius in [0.0, -1.0, f64::NAN, 0.95] {
        let arc = FieldDimensions { corner_arc_radius_m: Some(radius), ..kid_size_2013() };
        assert_eq!(Field::new(arc).expect_err("refused").key, "corner_arc_radius_m");
    }
}
