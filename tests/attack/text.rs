//! Damage to text that people write and programs read: TOML, JSON, YAML, CSV, queries.

use crate::draw::Draw;

/// A character that belongs to a number.
fn of_number(c: u8) -> bool {
    c.is_ascii_digit() || matches!(c, b'.' | b'-' | b'+')
}

/// Where numbers stand.
fn numbers(text: &str) -> Vec<(usize, usize)> {
    let bytes = text.as_bytes();
    let mut found = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        let starts = of_number(bytes[at]) && (at == 0 || !bytes[at - 1].is_ascii_alphanumeric());
        if !starts {
            at += 1;
            continue;
        }
        let mut end = at;
        while end < bytes.len() && (of_number(bytes[end]) || (end > at && matches!(bytes[end], b'e' | b'E'))) {
            end += 1;
        }
        if bytes[at..end].iter().any(u8::is_ascii_digit) {
            found.push((at, end));
        }
        at = end;
    }
    found
}

/// Where the insides of double-quoted strings stand.
fn strings(text: &str) -> Vec<(usize, usize)> {
    let quotes: Vec<usize> = text.bytes().enumerate().filter(|(_, c)| *c == b'"').map(|(at, _)| at).collect();
    quotes.as_chunks::<2>().0.iter().map(|[one, other]| (one + 1, *other)).collect()
}

fn number(draw: &mut Draw, now: &str) -> String {
    const ODD: [&str; 18] = [
        "0",
        "-0.0",
        "1",
        "-1",
        "nan",
        "inf",
        "-inf",
        "1e999",
        "-1e999",
        "1e-999",
        "1e308",
        "1e-320",
        "1e154",
        "18446744073709551616",
        "9223372036854775807",
        "-9223372036854775808",
        "4294967296",
        "0x7fffffff",
    ];
    match draw.below(3) {
        0 => (*draw.one_of(&ODD)).to_owned(),
        1 => {
            let value = draw.float(now.parse().unwrap_or(1.0));
            format!("{value:e}")
        }
        _ => now.parse::<f64>().map_or_else(|_| "1".to_owned(), |now| (now * draw.between(-0.5, 3.0)).to_string()),
    }
}

fn word(draw: &mut Draw) -> String {
    match draw.below(8) {
        0 => String::new(),
        1 => "x".repeat(*draw.one_of(&[300, 70_000])),
        2 => "../../../../etc/passwd".to_owned(),
        3 => "/dev/zero".to_owned(),
        4 => "\\u0000".to_owned(),
        5 => "\u{202e}n\u{e4}h".to_owned(),
        6 => "%s%n{}$(id)`id`".to_owned(),
        _ => ".".to_owned(),
    }
}

/// One to three of: numbers and strings replaced, lines left out, doubled, exchanged or cut, brackets without end, bytes.
pub fn damage(draw: &mut Draw, text: &str) -> Vec<u8> {
    let mut text = text.to_owned();
    for _ in 0..*draw.one_of(&[1, 1, 1, 2, 3]) {
        text = damaged_once(draw, text);
    }
    let mut bytes = text.into_bytes();
    if draw.chance(0.1) {
        crate::bytes::damage(draw, &mut bytes);
    }
    bytes
}

fn damaged_once(draw: &mut Draw, mut text: String) -> String {
    match draw.below(12) {
        0..=5 => {
            let found = numbers(&text);
            if let Some((from, to)) = found.get(draw.below(found.len())).copied() {
                let new = number(draw, &text[from..to]);
                text.replace_range(from..to, &new);
            }
            text
        }
        6 | 7 => {
            let found = strings(&text);
            if let Some((from, to)) = found.get(draw.below(found.len())).copied() {
                let new = word(draw);
                text.replace_range(from..to, &new);
            }
            text
        }
        8 | 9 => {
            let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
            let (one, other) = (draw.below(lines.len()), draw.below(lines.len()));
            if lines.is_empty() {
                return text;
            }
            match draw.below(3) {
                0 => drop(lines.remove(one)),
                1 => lines.insert(other, lines[one]),
                _ => lines.swap(one, other),
            }
            lines.concat()
        }
        10 => {
            let deep = *draw.one_of(&["[", "{\"a\":", "a=[", "((", "{a={"]);
            let at = (0..=draw.below(text.len() + 1)).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0);
            text.insert_str(at, &deep.repeat(*draw.one_of(&[3, 20_000])));
            text
        }
        _ => {
            let names: Vec<usize> =
                text.char_indices().filter(|(_, c)| c.is_ascii_lowercase()).map(|(at, _)| at).collect();
            if let Some(at) = names.get(draw.below(names.len())).copied() {
                let letter: &&str = draw.one_of(&["", "x", "_", "A"]);
                text.replace_range(at..=at, letter);
            }
            text
        }
    }
}
