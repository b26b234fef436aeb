//! Writes JUnit XML for CI servers, restricted to the part that all of them read.

use std::path::Path;

use super::settings::UsageError;
use super::{output, paths};
use crate::config::plain_file;

/// One test case; it passes if it has no faults.
pub struct TestCase {
    pub name: String,
    pub seconds: f64,
    /// One line each.
    pub faults: Vec<String>,
}

pub fn document(suite: &str, tests: &[TestCase]) -> String {
    let failures = tests.iter().filter(|test| !test.faults.is_empty()).count();
    let seconds: f64 = tests.iter().map(|test| test.seconds).sum();
    let suite = escaped(suite);
    let mut text = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<testsuites>\n\
         <testsuite name=\"{suite}\" tests=\"{}\" failures=\"{failures}\" errors=\"0\" time=\"{seconds:.3}\">\n",
        tests.len()
    );
    for TestCase { name, seconds, faults } in tests {
        let head = format!("<testcase classname=\"{suite}\" name=\"{}\" time=\"{seconds:.3}\"", escaped(name));
        match faults.first() {
            None => text.push_str(&format!("{head}/>\n")),
            Some(first) => text.push_str(&format!(
                "{head}>\n<failure message=\"{}\">{}</failure>\n</testcase>\n",
                escaped(first),
                escaped(&faults.join("\n"))
            )),
        }
    }
    text.push_str("</testsuite>\n</testsuites>\n");
    text
}

/// Checks before long work that the file's folder exists.
pub fn check_folder(path: &Path) -> Result<(), UsageError> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    match folder {
        Some(folder) if !folder.is_dir() => {
            Err(UsageError(format!("{}: its folder does not exist: make it first", path.display())))
        }
        _ => Ok(()),
    }
}

/// Writes a failed test for a run that did not get to its tests, so that no earlier result stands for it. It is not known
/// what such a run would have read, so nothing but a result is written over.
pub fn write_failure(path: &Path, suite: &str, error: &anyhow::Error) {
    // The result is written already: only the reader of standard output has gone.
    if output::is_broken_pipe(error) {
        return;
    }
    let test = TestCase { name: "run".to_owned(), seconds: 0.0, faults: vec![format!("{error:#}")] };
    if !is_free_or_a_result(path) {
        eprintln!("realitysim: {}: not written: it is something else than a result of an earlier run", path.display());
        return;
    }
    if let Err(also) = paths::write(path, &document(suite, &[test])) {
        eprintln!("realitysim: {also:#}");
    }
}

/// Largest old result that is read: that of a hundred thousand cases.
const MAX_RESULT_BYTES: u64 = 64 << 20;

fn is_free_or_a_result(path: &Path) -> bool {
    !path.exists()
        || plain_file::read(path, MAX_RESULT_BYTES).is_ok_and(|bytes| bytes.is_empty() || bytes.starts_with(b"<?xml"))
}

/// Escapes text for elements and attributes alike. XML allows no control characters but tab and line ends.
fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            '\n' | '\t' => safe.push(letter),
            letter if letter.is_control() || matches!(letter, '\u{fffe}' | '\u{ffff}') => safe.push('?'),
            letter => safe.push(letter),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whatever_a_message_holds_the_document_is_xml() {
        let test = |faults: &[&str]| TestCase {
            name: "a<b>&\"c\"".to_owned(),
            seconds: 0.5,
            faults: faults.iter().map(|fault| (*fault).to_owned()).collect(),
        };
        let text = document("x & y", &[test(&[]), test(&["1 < 2\u{1b}[31m", "second"])]);
        assert!(text.contains("tests=\"2\" failures=\"1\""), "{text}");
        assert!(text.contains("message=\"1 &lt; 2?[31m\">1 &lt; 2?[31m\nsecond</failure>"), "{text}");
        assert!(text.contains("name=\"a&lt;b&gt;&amp;&quot;c&quot;\""), "{text}");
        assert_eq!(text.matches("<testcase").count(), text.matches("/>").count() + text.matches("</testcase>").count());
    }
}
