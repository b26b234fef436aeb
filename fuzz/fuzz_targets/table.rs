#![no_main]

use realitysim_fuzz::parsers;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| parsers::table(bytes));
