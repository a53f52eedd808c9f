//! Random meshes, strokes and degenerate positions, every invariant after every sample: a bounded run of what `fuzz/` runs for as long as
//! one likes. `KEYHOLE_FUZZ_SAMPLES=1000000 cargo test --release -p keyhole-cutting --test random` runs a million samples.

#[path = "common/cases.rs"]
mod cases;
#[expect(dead_code, reason = "other tests use the rest of it")]
mod common;

use arbitrary::{Arbitrary, Unstructured};
use cases::{Case, run};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Samples that the test suite runs.
const SAMPLES: usize = 20_000;

/// Bytes that follow from a seed (Vigna's SplitMix64).
fn bytes(seed: u64) -> Vec<u8> {
    let mut state = seed;
    (0..256)
        .flat_map(|_| {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (z ^ (z >> 31)).to_le_bytes()
        })
        .collect()
}

fn case(seed: u64) -> Case {
    Case::arbitrary(&mut Unstructured::new(&bytes(seed))).expect("there are bytes enough")
}

#[test]
fn random_strokes_break_no_invariant() {
    let read = |name: &str| std::env::var(name).ok().and_then(|v| v.parse::<u64>().ok());
    let samples = read("KEYHOLE_FUZZ_SAMPLES").map_or(SAMPLES, |n| n as usize);
    let (mut seed, mut done, mut failed) = (read("KEYHOLE_FUZZ_SEED").unwrap_or(0), 0, Vec::new());
    while done < samples && failed.len() < 20 {
        let case = case(seed);
        match catch_unwind(AssertUnwindSafe(|| run(&case))) {
            Ok(n) => done += n,
            Err(_) => {
                eprintln!("seed {seed}: {case:?}");
                failed.push(seed);
            }
        }
        seed += 1;
    }
    println!("{done} samples of {seed} cases");
    assert!(failed.is_empty(), "seeds {failed:?} break an invariant; the messages are above");
}
