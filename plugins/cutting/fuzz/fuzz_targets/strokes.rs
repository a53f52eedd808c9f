//! Random meshes, strokes and degenerate positions, with the kernel's invariants checked after every sample. What it finds becomes a test in
//! `tests/random.rs`.

#![no_main]

#[path = "../../tests/common/cases.rs"]
mod cases;
#[path = "../../tests/common/mod.rs"]
#[expect(dead_code, reason = "tests use the rest of it")]
mod common;

libfuzzer_sys::fuzz_target!(|case: cases::Case| {
    cases::run(&case);
});
