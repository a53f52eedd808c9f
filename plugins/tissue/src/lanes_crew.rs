//! Many short steps on several threads: every step is some tasks that do not depend on each other, and no task of a step begins before all of the step
//! before it are done. A barrier of a thread pool costs microseconds, which is what a colour of a small organ costs; here a worker waits for a
//! counter.
//!
//! Workers wait for tasks alone that a running worker has begun, so that any number of them, late or never come, gets to the end. Each begins with a share of its own
//! of every step, the same in each round, so that what it works on is in its own cache, and then helps the others.

use crate::lanes::{Near, Nodes};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Most workers.
const MOST: usize = 16;

/// Times to look at a counter before the processor is offered to others.
const PATIENCE: u32 = 500;

/// Tells the others when a worker panics: they would wait for ever.
struct Alarm<'a>(&'a AtomicBool);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

/// One step: the next task of each worker's share, and how many tasks are done.
#[derive(Debug, Default)]
#[repr(align(128))]
struct Step {
    next: [AtomicU32; MOST],
    done: AtomicU32,
}

/// The counters of a run and the memory of its workers; nothing is kept there between runs.
#[derive(Debug, Default)]
pub(crate) struct Crew {
    steps: Vec<Step>,
    memory: Vec<Mutex<Near>>,
}

impl Clone for Crew {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl Crew {
    /// Runs `steps` steps one after the other with up to `workers` workers: `tasks` says how many tasks a step has, and `task(step, i, near)` does one of them
    /// with some memory of its worker's own.
    pub(crate) fn run(
        &mut self,
        workers: usize,
        steps: usize,
        tasks: impl Fn(usize) -> usize + Sync,
        task: impl Fn(usize, usize, &mut Nodes) + Sync,
    ) {
        let workers = workers.clamp(1, MOST);
        self.memory.resize_with(workers.max(self.memory.len()), Mutex::default);
        let Self { steps: counters, memory } = self;
        if workers == 1 {
            let mut own = lock(&memory[0]);
            let own = own.nodes();
            for step in 0..steps {
                for i in 0..tasks(step) {
                    task(step, i, own);
                }
            }
            return;
        }
        if counters.len() < steps {
            counters.resize_with(steps, Step::default);
        }
        for (number, step) in counters.iter_mut().enumerate().take(steps) {
            *step.done.get_mut() = 0;
            let all = tasks(number);
            for (worker, next) in step.next.iter_mut().enumerate().take(workers) {
                *next.get_mut() = share(all, worker, workers);
            }
        }
        let counters = &counters[..steps];
        let broken = AtomicBool::new(false);
        join_all(workers, &|worker| {
            let _alarm = Alarm(&broken);
            let mut own = lock(&memory[worker]);
            let own = own.nodes();
            for (number, step) in counters.iter().enumerate() {
                let all = tasks(number);
                let mut done = 0;
                for turn in 0..workers {
                    let whose = (worker + turn) % workers;
                    let end = share(all, whose + 1, workers);
                    while step.next[whose].load(Ordering::Relaxed) < end {
                        let i = step.next[whose].fetch_add(1, Ordering::Relaxed);
                        if i < end {
                            task(number, i as usize, own);
                            done += 1;
                        }
                    }
                }
                step.done.fetch_add(done, Ordering::AcqRel);
                let mut looked = 0;
                while step.done.load(Ordering::Acquire) < all as u32 {
                    if broken.load(Ordering::Relaxed) {
                        return;
                    }
                    looked += 1;
                    if looked % PATIENCE == 0 {
                        std::thread::yield_now();
                    } else {
                        std::hint::spin_loop();
                    }
                }
            }
        });
    }
}

fn lock(memory: &Mutex<Near>) -> MutexGuard<'_, Near> {
    memory.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Where the share of a worker begins.
fn share(tasks: usize, worker: usize, workers: usize) -> u32 {
    (tasks * worker / workers) as u32
}

/// Runs one worker after the other where there is one thread, and all at a time where there are enough.
fn join_all(workers: usize, work: &(impl Fn(usize) + Sync)) {
    fn from(first: usize, workers: usize, work: &(impl Fn(usize) + Sync)) {
        if first + 1 == workers {
            work(first);
        } else {
            rayon::join(|| work(first), || from(first + 1, workers, work));
        }
    }
    from(0, workers, work);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU64;

    /// Every task is done once, and none before those of the step before it, with more workers than threads and fewer.
    #[test]
    fn steps_are_in_order_and_complete() {
        for threads in [1, 2, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let Ok(pool) = pool else { unreachable!("a pool of {threads}") };
            for workers in [1, 2, 5] {
                let sizes = [7, 0, 1, 64, 3];
                let counts: Vec<AtomicU64> = (0..sizes.len()).map(|_| AtomicU64::new(0)).collect();
                let mut crew = Crew::default();
                for round in 1..=3_u64 {
                    pool.install(|| {
                        crew.run(
                            workers,
                            sizes.len(),
                            |s| sizes[s],
                            |s, i, _| {
                                if s > 0 {
                                    let before: u64 = (0..sizes[s - 1] as u64).map(|i| i + 1).sum();
                                    assert_eq!(counts[s - 1].load(Ordering::Relaxed), before * round);
                                }
                                counts[s].fetch_add(i as u64 + 1, Ordering::Relaxed);
                            },
                        );
                    });
                }
                for (count, size) in counts.iter().zip(sizes) {
                    assert_eq!(count.load(Ordering::Relaxed), 3 * (1..=size as u64).sum::<u64>());
                }
            }
        }
    }
}
