//! A hand changes its instrument: it opens its jaws, draws the instrument out of the trocar, and another one comes in as far as the trocar is long. That takes its time.

use crate::kinematics::{TrocarLimits, TrocarState};
use bevy_ecs::prelude::*;
use keyhole_whiteboard::{Exchange, ExchangeStage, InstrumentKind};

/// How an instrument is exchanged.
#[derive(Resource, Clone, Copy, Debug, PartialEq)]
pub struct ExchangeSettings {
    /// Speed at which it is drawn out, m/s. Default 0.15.
    pub out_m_s: f32,
    /// Time from one instrument to the next outside, s. Default 2: handed over by an assistant who has it ready.
    pub outside_s: f32,
    /// Speed at which the new one comes in, m/s. Default 0.08: a careful hand that does not see its tip.
    pub in_m_s: f32,
    /// How far the new one comes in by itself, m, or as far as the old one had been where that is less. Default 0.05.
    pub in_m: f32,
    /// Time in which the jaws open or close, s. Default 0.2.
    pub grip_s: f32,
}

impl Default for ExchangeSettings {
    fn default() -> Self {
        Self { out_m_s: 0.15, outside_s: 2.0, in_m_s: 0.08, in_m: 0.05, grip_s: 0.2 }
    }
}

/// The beginning of an exchange.
#[must_use]
pub fn begin(to: InstrumentKind, settings: &ExchangeSettings) -> Exchange {
    Exchange { to, stage: ExchangeStage::Withdraw, outside_s: settings.outside_s }
}

/// What a tick of an exchange came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// It goes on.
    GoesOn,
    /// The old instrument is out: from now on it is the new one.
    Swap,
    /// The hand has its instrument again.
    Done,
}

/// A tick of `dt_s` s of an exchange. The instrument turns no more than it did: a shaft is drawn out along itself.
#[must_use]
pub fn exchange_tick(
    mut state: TrocarState,
    exchange: &mut Exchange,
    settings: &ExchangeSettings,
    limits: &TrocarLimits,
    dt_s: f32,
) -> (TrocarState, Progress) {
    state.pedal = false;
    let mut progress = Progress::GoesOn;
    match exchange.stage {
        ExchangeStage::Withdraw if state.grip > 0.0 => state.grip -= dt_s / settings.grip_s,
        ExchangeStage::Withdraw => {
            state.insertion_m -= settings.out_m_s * dt_s;
            if state.insertion_m <= limits.insertion_min_m {
                (exchange.stage, progress) = (ExchangeStage::Outside, Progress::Swap);
                (state.grip, state.roll_rad) = (1.0, 0.0);
            }
        }
        ExchangeStage::Outside => {
            exchange.outside_s -= dt_s;
            if exchange.outside_s <= 0.0 {
                exchange.stage = ExchangeStage::Insert;
            }
        }
        ExchangeStage::Insert => {
            state.insertion_m += settings.in_m_s * dt_s;
            if state.insertion_m >= settings.in_m {
                (state.insertion_m, progress) = (settings.in_m, Progress::Done);
            }
        }
    }
    (limits.clamp(state), progress)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Opened in 0.2 s, out from 11 cm to 1 cm at 0.15 m/s in 0.67 s, 2 s outside, in to 5 cm at 0.08 m/s in 0.5 s.
    #[test]
    fn an_exchange_takes_its_time() {
        let (settings, limits, dt_s) = (ExchangeSettings::default(), TrocarLimits::default(), 1.0 / 60.0);
        let mut exchange = begin(InstrumentKind::Scissors, &settings);
        let mut state = TrocarState { insertion_m: 0.11, yaw_rad: 0.3, grip: 1.0, pedal: true, ..Default::default() };
        let (mut ticks, mut swapped) = (0, None);
        loop {
            let (now, progress) = exchange_tick(state, &mut exchange, &settings, &limits, dt_s);
            (state, ticks) = (now, ticks + 1);
            assert!(!state.pedal && state.yaw_rad == 0.3);
            match progress {
                Progress::Swap => swapped = Some((ticks, state.insertion_m)),
                Progress::Done => break,
                Progress::GoesOn => assert!(ticks < 1000, "it never ends"),
            }
        }
        assert_eq!((state.insertion_m, state.grip), (0.05, 1.0));
        assert!(matches!(swapped, Some((50..=54, 0.01))), "{swapped:?}");
        assert!((f64::from(ticks) / 60.0 - (0.2 + 0.667 + 2.0 + 0.5)).abs() < 0.1, "{ticks} ticks");
    }
}
