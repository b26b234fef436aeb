//! What the fuzzer calls stands with the tests, which call it with every input that is kept.

#[path = "../../tests/fuzz/parsers.rs"]
pub mod parsers;
