use realitysim::config::{field_names, load_field, parse_field};
use realitysim::geometry::{Field, field::Area};

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
