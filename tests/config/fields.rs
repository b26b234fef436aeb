use glam::DVec2;
use realitysim::config::{Settings, field_names, load_field, load_field_of_size, parse_field};
use realitysim::geometry::Field;
use realitysim::geometry::field::{Area, Stroke};

type Row = (&'static str, [f64; 2], f64, f64, [f64; 2], Option<[f64; 2]>, f64, [f64; 3]);

/// Name, length x width, border, circle, goal area, penalty area, penalty mark, goal width x height x depth.
const TABLE: [Row; 6] = [
    ("adult-2020", [14.0, 9.0], 1.0, 3.0, [1.0, 4.0], Some([3.0, 6.0]), 2.1, [2.6, 1.8, 0.6]),
    ("kid-2009", [6.0, 4.0], 0.7, 1.2, [0.6, 2.2], None, 1.8, [1.5, 0.8, 0.5]),
    ("kid-2014", [9.0, 6.0], 0.7, 1.5, [1.0, 5.0], None, 2.1, [2.6, 1.2, 0.6]),
    ("kid-2020", [9.0, 6.0], 1.0, 1.5, [1.0, 3.0], Some([2.0, 5.0]), 1.5, [2.6, 1.2, 0.6]),
    ("spl-2013", [9.0, 6.0], 0.7, 1.5, [0.6, 2.2], None, 1.3, [1.5, 0.8, 0.5]),
    ("spl-2020", [9.0, 6.0], 0.7, 1.5, [0.6, 2.2], Some([1.65, 4.0]), 1.3, [1.5, 0.8, 0.5]),
];

#[test]
fn the_shipped_fields_have_the_rule_books_sizes() {
    let names = field_names();
    for (name, size, border, circle, goal_area, penalty_area, mark, goal) in TABLE {
        assert!(names.iter().any(|known| known == name), "{name} is not among {names:?}");
        let field = load_field(name).expect("a shipped field");
        let area = |[depth_m, width_m]: [f64; 2]| Area { depth_m, width_m };
        assert_eq!([field.length_m, field.width_m], size, "{name}");
        assert_eq!(field.line_width_m, 0.05, "{name}");
        assert_eq!(field.border_strip_m, border, "{name}");
        assert_eq!(field.centre_circle_diameter_m, circle, "{name}");
        assert_eq!(field.goal_area, Some(area(goal_area)), "{name}");
        assert_eq!(field.penalty_area, penalty_area.map(area), "{name}");
        assert_eq!(field.penalty_mark_from_goal_line_m, Some(mark), "{name}");
        let posts = field.goal.expect("every shipped field has goals");
        assert_eq!([posts.width_m, posts.height_m, posts.depth_m], goal, "{name}");
    }
}

type OuterRow = (&'static str, [f64; 2], f64, f64, f64, Option<f64>, [f64; 2], [f64; 2], f64, [f64; 3]);

/// Name, length x width, line width, border, circle, corner arcs, goal area, penalty area, penalty mark, goal width between the posts x
/// height x depth. The rule book measures to the outer edges of the lines.
const HUMANOID_SOCCER_LEAGUE: [OuterRow; 3] = [
    ("hsl-small-2026", [9.0, 6.0], 0.05, 1.0, 1.5, None, [1.0, 3.0], [2.0, 4.0], 1.5, [1.8, 1.2, 0.7]),
    ("hsl-middle-2026", [14.0, 9.0], 0.05, 1.0, 3.0, Some(0.5), [1.0, 4.0], [3.0, 6.0], 2.0, [2.4, 1.8, 0.7]),
    ("hsl-large-2026", [22.0, 14.0], 0.12, 1.0, 4.0, Some(1.0), [1.0, 5.0], [3.5, 7.0], 2.5, [3.0, 2.0, 1.0]),
];

#[test]
fn the_fields_of_2026_are_the_rule_book_s_between_line_centres() {
    for (name, size, line, border, circle, arc, goal_area, penalty_area, mark, goal) in HUMANOID_SOCCER_LEAGUE {
        let field = load_field(name).expect("a shipped field");
        let same =
            |found: f64, outer: f64| assert!((found - (outer - line)).abs() < 1e-9, "{name}: {found} for {outer}");
        assert_eq!((field.line_width_m, field.border_strip_m), (line, border), "{name}");
        same(field.length_m, size[0]);
        same(field.width_m, size[1]);
        same(field.centre_circle_diameter_m, circle);
        assert_eq!(field.corner_arc_radius_m.is_some(), arc.is_some(), "{name}");
        field.corner_arc_radius_m.zip(arc).into_iter().for_each(|(found, outer)| same(found, outer));
        for (found, [depth, width]) in [(field.goal_area, goal_area), (field.penalty_area, penalty_area)] {
            let Area { depth_m, width_m } = found.expect("every field of 2026 has both areas");
            same(depth_m, depth);
            same(width_m, width);
        }
        // The middle of the mark is no edge: only the goal line's half is taken off.
        same(field.penalty_mark_from_goal_line_m.expect("a mark") - line / 2.0, mark);
        let posts = field.goal.expect("every shipped field has goals");
        assert!((posts.width_m - posts.post_diameter_m - goal[0]).abs() < 1e-9, "{name}");
        assert_eq!([posts.height_m, posts.depth_m], [goal[1], goal[2]], "{name}");
    }
}

/// Sizes that were measured between line centres on the carpets of 2026.
#[test]
fn carpets_of_2026_are_within_4_cm_of_the_rule_book_s_fields() {
    let measured = load_field("hsl-small-incheon-2026").expect("a shipped field");
    assert_eq!([measured.length_m, measured.width_m, measured.line_width_m], [8.95, 5.95, 0.06]);
    let ruled = Field::new(load_field("hsl-small-2026").expect("a shipped field")).expect("checked");
    for point in Field::new(measured).expect("checked").points(500) {
        let off_m = ruled.distance_to_centre_line(point.position);
        assert!(off_m < 0.04, "{}: {off_m}", point.position);
    }
}

#[test]
fn every_shipped_field_is_the_same_in_every_mirror() {
    for name in field_names() {
        let field = Field::new(load_field(&name).expect("a shipped field")).expect("checked");
        for point in field.points(500) {
            for signs in [DVec2::new(-1.0, 1.0), DVec2::new(1.0, -1.0), DVec2::new(-1.0, -1.0)] {
                let off_m = field.distance_to_centre_line(point.position * signs);
                assert!(off_m < 1e-12, "{name}: {} {off_m}", point.position);
            }
        }
    }
}

/// Only the strokes of marks end free.
#[test]
fn every_line_of_every_shipped_field_ends_on_another() {
    for name in field_names() {
        let field = Field::new(load_field(&name).expect("a shipped field")).expect("checked");
        let mark_m = field.dimensions().mark_size_m;
        for (which, stroke) in field.strokes().iter().enumerate() {
            let ends = match *stroke {
                Stroke::Segment { from, to } => vec![from, to],
                Stroke::Circle { .. } => vec![],
                Stroke::Quarter { centre, radius, side } => {
                    vec![centre + DVec2::X * side * radius, centre + DVec2::Y * side * radius]
                }
            };
            let others = field.strokes().iter().enumerate().filter(|(other, _)| *other != which);
            let nearest = |end: &DVec2| others.clone().map(|(_, other)| other.distance(*end)).fold(f64::MAX, f64::min);
            for end in ends.iter().filter(|_| stroke.length() > mark_m + 1e-9) {
                assert!(nearest(end) < 1e-9, "{name}: {end} of {stroke:?}");
            }
        }
    }
}

#[test]
fn a_field_of_measured_size_is_refused_if_its_areas_no_longer_fit() {
    let field = load_field_of_size("kid-2009", Some([5.9, 4.02])).expect("a good size");
    assert_eq!([field.length_m, field.width_m], [5.9, 4.02]);
    assert_eq!(field.goal_area, load_field("kid-2009").expect("shipped").goal_area);
    assert_eq!(load_field_of_size("kid-2009", None).expect("shipped"), load_field("kid-2009").expect("shipped"));
    let message = load_field_of_size("kid-2020", Some([9.0, 4.5])).expect_err("refused").to_string();
    assert!(message.contains("9 x 4.5 m is no size for the field kid-2020: penalty_area.width_m is 5"), "{message}");
}

#[test]
fn a_measured_size_in_a_config_is_checked() {
    let parsed =
        Settings::parse("field = 'kid-2009'\nfield_size_m = [5.90, 4.02]", "robot.toml").expect("a good config");
    assert_eq!(parsed.field_dimensions().expect("a good field").length_m, 5.9);
    for (size, word) in [("[4.02, 5.9]", "comes first"), ("[0.5, 0.4]", "1 to 200 m"), ("[nan, 4.0]", "1 to 200 m")] {
        let message =
            Settings::parse(&format!("field_size_m = {size}"), "robot.toml").expect_err("refused").to_string();
        assert!(message.starts_with("robot.toml: field_size_m is ") && message.contains(word), "{message}");
    }
    assert!(Settings::names_field("field = 'kid-2009'") && !Settings::names_field("robot = 'field'"));
}

/// Also those that the table does not know: a new file must not need a new test.
#[test]
fn every_shipped_field_loads() {
    for name in field_names() {
        let field = load_field(&name).expect("a shipped field");
        assert!(Field::new(field).is_ok(), "{name}");
    }
}

#[test]
fn a_field_is_also_a_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ours.toml");
    std::fs::copy("config/fields/kid-2020.toml", &path).expect("a copy");
    let path = path.to_str().expect("a plain path");
    assert_eq!(load_field(path).expect("the file"), load_field("kid-2020").expect("the shipped field"));
}

#[test]
fn an_unknown_name_lists_the_known_ones() {
    let message = load_field("kid-2021").expect_err("refused").to_string();
    assert!(message.contains("no field is called \"kid-2021\"") && message.contains("kid-2020, "), "{message}");
}

#[test]
fn a_path_that_is_not_there_is_not_taken_for_a_name() {
    for path in ["nowhere/kid-2020", "kid-2021.toml"] {
        let message = load_field(path).expect_err("refused").to_string();
        assert!(message.starts_with(&format!("{path}: cannot be read")), "{message}");
    }
}

#[test]
fn a_wrong_file_names_itself_its_key_and_what_is_right() {
    let text = std::fs::read_to_string("config/fields/kid-2020.toml").expect("a shipped file");
    let refused = |from: &str, to: &str| {
        assert!(text.contains(from));
        parse_field(&text.replace(from, to), "ours.toml").expect_err("refused").to_string()
    };
    let message = refused("width_m = 6.0", "width_m = -6.0");
    assert_eq!(message, "ours.toml: width_m is -6: a field is 1 to 200 m wide");
    let message = refused("border_strip_m", "border_stripe_m");
    assert!(message.starts_with("ours.toml: ") && message.contains("unknown field `border_stripe_m`"), "{message}");
    let message = refused("length_m = 9.0\n", "");
    assert!(message.contains("missing field `length_m`"), "{message}");
    let message = refused("length_m = 9.0", "length_m = nan");
    assert!(message.contains("length_m is NaN"), "{message}");
}
