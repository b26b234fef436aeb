//! Rewords the errors of the TOML parser for people who have never seen the program's types.

/// Returns the parser's message in plain words: the place, the line, and what is wrong with it.
pub fn in_words(error: &toml::de::Error) -> String {
    let text = error.to_string();
    let text = text.trim_end();
    match text.strip_suffix(error.message().trim_end()) {
        Some(place) => format!("{place}{}", plain(error.message().trim_end())),
        None => text.to_owned(),
    }
}

/// Rewords one of serde's messages. An unknown name is followed by the known one that was probably meant.
pub fn plain(message: &str) -> String {
    if let Some((unknown, known)) = split_unknown_name(message) {
        let closest = closest_name(unknown, known.split('`').skip(1).step_by(2));
        return match closest {
            Some(name) if message.starts_with(FIELD) => format!("{FIELD}{unknown}`: did you mean `{name}`?"),
            Some(name) => format!("{message}: did you mean `{name}`?"),
            None => message.to_owned(),
        };
    }
    let Some((found, expected)) = message.split_once(", expected ") else { return message.to_owned() };
    let Some(found) = found.strip_prefix("invalid type: ").or_else(|| found.strip_prefix("invalid value: ")) else {
        return message.to_owned();
    };
    // The lines below the first say where the error is.
    let (expected, rest) = expected.split_once('\n').map_or((expected, ""), |(expected, rest)| (expected, rest));
    let rest = if rest.is_empty() { String::new() } else { format!("\n{rest}") };
    format!("{} is needed, and this is {}{rest}", describe_expected(expected), describe_found(found))
}

/// Start of serde's message about an unknown key.
const FIELD: &str = "unknown field `";
/// Start of serde's message about an unknown value of an enumeration.
const VARIANT: &str = "unknown variant `";

/// Splits a message about an unknown name into that name and the list of known ones.
fn split_unknown_name(message: &str) -> Option<(&str, &str)> {
    let rest = message.strip_prefix(FIELD).or_else(|| message.strip_prefix(VARIANT))?;
    rest.split_once('`')
}

/// Smallest Jaro-Winkler similarity, 0 to 1, at which a name is taken for a mistyped known one.
const MIN_SIMILARITY: f64 = 0.8;

/// Returns the known name that was probably meant: the most similar one, if it is similar enough.
pub fn closest_name<'a>(given: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let candidates = names.map(|name| (name, strsim::jaro_winkler(given, name)));
    let best = candidates.max_by(|a, b| a.1.total_cmp(&b.1));
    best.filter(|(_, similarity)| *similarity >= MIN_SIMILARITY).map(|(name, _)| name)
}

/// Rewords what serde expected: types become words.
fn describe_expected(expected: &str) -> &str {
    match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, 0 or more,",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "f32" | "f64" => "a number",
        "a boolean" => "true or false",
        "a string" => "a text in quotes",
        "a sequence" => "a list in [ ]",
        "a map" => "a table",
        other if other.starts_with("struct ") => "a table",
        other => other,
    }
}

/// Rewords what serde found: a type and a value, or a type alone.
fn describe_found(found: &str) -> String {
    let named = |what: &str, value: &str| format!("{what} {}", value.trim_matches('`'));
    match found.split_once(' ') {
        Some(("string", value)) => format!("the text {value}"),
        Some(("integer", value)) => named("the number", value),
        Some(("boolean", value)) => value.trim_matches('`').to_owned(),
        Some(("floating", value)) => named("the number", value.trim_start_matches("point ")),
        _ if found == "sequence" => "a list".to_owned(),
        _ if found == "map" => "a table".to_owned(),
        _ => found.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    fn error_of(text: &str) -> String {
        Settings::parse(text, "robot.toml").expect_err("refused").to_string()
    }

    #[test]
    fn errors_are_worded_without_the_names_of_types() {
        for (text, words) in [
            ("[fitler]\n", "unknown field `fitler`: did you mean `filter`?"),
            ("[filter]\nparticels = 3\n", "line 2, column 1"),
            ("[filter]\nparticels = 3\n", "unknown field `particels`: did you mean `particles`?"),
            ("[filter]\nxyzzy = 3\n", "unknown field `xyzzy`, expected one of `model`"),
            ("[filter]\nparticles = \"many\"\n", "a whole number, 0 or more, is needed, and this is the text \"many\""),
            ("[filter]\nparticles = 2.5\n", "a whole number, 0 or more, is needed, and this is the number 2.5"),
            ("[filter]\nvalid_share = true\n", "a number is needed, and this is true"),
            ("robot = 3\n", "a text in quotes is needed, and this is the number 3"),
            ("filter = 3\n", "a table is needed, and this is the number 3"),
            ("[filter]\nmodel = \"gaus\"\n", "expected `gauss` or `distance`: did you mean `gauss`?"),
        ] {
            let said = error_of(text);
            assert!(said.contains(words), "{text}: {said}");
            assert!(!said.contains("usize") && !said.contains("f64"), "{said}");
        }
    }

    #[test]
    fn only_a_similar_name_is_suggested() {
        let fields = ["kid-2009", "kid-2014", "spl-2020"];
        assert_eq!(closest_name("kid2014", fields.into_iter()), Some("kid-2014"));
        assert_eq!(closest_name("moon", fields.into_iter()), None);
        assert_eq!(plain("something else"), "something else");
    }
}
