//! The heap, counted: a test that includes this file has it as its allocator.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicIsize, AtomicU64, Ordering};

/// The system's allocator, counted.
struct Counted;

/// Allocations so far.
pub static CALLS: AtomicU64 = AtomicU64::new(0);
/// Bytes of all allocations so far.
pub static BYTES: AtomicU64 = AtomicU64::new(0);
/// Bytes that are allocated now.
pub static LIVE: AtomicIsize = AtomicIsize::new(0);

#[expect(unsafe_code, reason = "every call is handed to the system's allocator as it is")]
// SAFETY: layouts and pointers go to `System` unchanged; what is counted does not allocate.
unsafe impl GlobalAlloc for Counted {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(layout.size() as u64, Ordering::Relaxed);
        LIVE.fetch_add(layout.size() as isize, Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size() as isize, Ordering::Relaxed);
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static HEAP: Counted = Counted;
