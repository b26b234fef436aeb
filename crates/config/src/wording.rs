//! What is wrong with a TOML file, in words for people who have never seen the program's types.

/// The parser's message: the place, the line, and what is wrong with it.
pub fn in_words(error: &toml::de::Error) -> String {
    let text = error.to_string();
    let text = text.trim_end();
    match text.strip_suffix(error.message().trim_end()) {
        Some(place) => format!("{place}{}", plain(error.message().trim_end())),
        None => text.to_owned(),
    }
}

/// One of serde's messages. A name that is not known is followed by the one that was probably meant.
pub fn plain(message: &str) -> String {
    if let Some((unknown, known)) = unknown(message) {
        let meant = meant(unknown, known.split('`').skip(1).step_by(2));
        return match meant {
            Some(name) if message.starts_with(FIELD) => format!("{FIELD}{unknown}`: did you mean `{name}`?"),
            Some(name) => format!("{message}: did you mean `{name}`?"),
            None => message.to_owned(),
        };
    }
    let Some((found, expected)) = message.split_once(", expected ") else { return message.to_owned() };
    let Some(found) = found.strip_prefix("invalid type: ").or_else(|| found.strip_prefix("invalid value: ")) else {
        return message.to_owned();
    };
    // What follows says where.
    let (expected, rest) = expected.split_once('\n').map_or((expected, ""), |(expected, rest)| (expected, rest));
    let rest = if rest.is_empty() { String::new() } else { format!("\n{rest}") };
    format!("{} is needed, and this is {}{rest}", wanted(expected), given(found))
}

const FIELD: &str = "unknown field `";
const VARIANT: &str = "unknown variant `";

/// The name that is not known, and the list of those that are.
fn unknown(message: &str) -> Option<(&str, &str)> {
    let rest = message.strip_prefix(FIELD).or_else(|| message.strip_prefix(VARIANT))?;
    rest.split_once('`')
}

/// Likeness of 0 to 1 from which a name is taken for another one, mistyped.
const ALIKE: f64 = 0.8;

/// The name among these that was probably meant.
pub(crate) fn meant<'a>(given: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let alike = names.map(|name| (name, strsim::jaro_winkler(given, name)));
    let best = alike.max_by(|a, b| a.1.total_cmp(&b.1));
    best.filter(|(_, likeness)| *likeness >= ALIKE).map(|(name, _)| name)
}

fn wanted(expected: &str) -> &str {
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

fn given(found: &str) -> String {
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

    fn said(text: &str) -> String {
        Settings::parse(text, "robot.toml").expect_err("refused").to_string()
    }

    #[test]
    fn what_is_wrong_is_said_without_the_names_of_types() {
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
            let said = said(text);
            assert!(said.contains(words), "{text}: {said}");
            assert!(!said.contains("usize") && !said.contains("f64"), "{said}");
        }
    }

    #[test]
    fn what_is_like_nothing_that_is_known_is_taken_for_nothing() {
        let fields = ["kid-2009", "kid-2014", "spl-2020"];
        assert_eq!(meant("kid2014", fields.into_iter()), Some("kid-2014"));
        assert_eq!(meant("moon", fields.into_iter()), None);
        assert_eq!(plain("something else"), "something else");
    }
}
