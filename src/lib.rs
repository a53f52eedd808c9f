//! Keyhole: a laparoscopic surgery simulator whose tissue is cut progressively, conformingly and again and again.
//!
//! The rooms under `plugins/` do not know each other; this crate knows them all. [`theatre`] reads what a scene needs from disk,
//! [`spawn`] puts it on the whiteboard, [`task`] what is to be reached in it, [`mod@simulation`] assembles the plugins of [`modules`] around it, [`census`] counts what each of them does and has,
//! [`perform`] lets a scene's demonstration run
//! without a window, [`mod@recording`] says what a recording of a scene starts with, [`window`] shares a window out between view and HUD, [`seek`] goes to another time of one and [`report`] says how it went. [`study`] holds the experiments. [`cli`] is the command line on top.

pub mod census;
pub mod cli;
pub mod margin;
pub mod modules;
pub mod perform;
pub mod quality;
pub mod recording;
pub mod replay_keys;
pub mod report;
pub mod seek;
pub mod simulation;
pub mod spawn;
pub mod stage;
pub mod study;
pub mod task;
pub mod theatre;
pub mod window;

pub use simulation::{Output, Settings, simulation};
pub use theatre::Theatre;
