//! Which tool each hand has, and what it does at the moment.

use crate::panel::{ACTIVE, QUIET};
use bevy_egui::egui::{RichText, Ui};
use keyhole_whiteboard::{Blade, Exchange, ExchangeStage, Grasp, Hand, Instrument, SuctionValve, Tray};

/// An instrument with what it does.
pub type Tool<'a> =
    (&'a Instrument, &'a Hand, Option<&'a Blade>, Option<&'a Grasp>, Option<&'a SuctionValve>, Option<&'a Exchange>, Option<&'a Tray>);

/// A line for each hand, the left one first.
pub fn show_tools<'a>(ui: &mut Ui, tools: impl Iterator<Item = Tool<'a>>, active: Option<Hand>) {
    let mut tools: Vec<_> = tools.collect();
    tools.sort_by_key(|(_, hand, ..)| matches!(hand, Hand::Right));
    for (instrument, hand, blade, grasp, valve, exchange, tray) in tools {
        let side = if *hand == Hand::Left { "Left" } else { "Right" };
        let marked = if active == Some(*hand) { "> " } else { "" };
        let line = format!("{marked}{side}: {}", instrument.name);
        let does = match exchange {
            Some(exchange) => Some(changes(exchange)),
            None if blade.is_some_and(|b| b.active) => Some("blade active".to_owned()),
            None if valve.is_some_and(|v| v.open) => Some("suction open".to_owned()),
            None => {
                grasp.filter(|g| g.points > 0).map(|g| format!("pinches {:.1} N, pulls {:.1} N{}", g.pinch_n, g.pull_n.length(), slips(g)))
            }
        };
        ui.label(match does {
            Some(does) => RichText::new(format!("{line}: {does}")).color(ACTIVE),
            None if tray.is_some_and(|t| !t.0.is_empty()) => RichText::new(format!("{line}   (X changes it)")).color(QUIET),
            None => RichText::new(line).color(QUIET),
        });
    }
}

fn changes(exchange: &Exchange) -> String {
    match exchange.stage {
        ExchangeStage::Withdraw => "is drawn out".into(),
        ExchangeStage::Outside => format!("comes in {:.1} s", exchange.outside_s.max(0.0)),
        ExchangeStage::Insert => "comes in".into(),
    }
}

/// A grasp is slipping when more than half of its points slide.
fn slips(grasp: &Grasp) -> &'static str {
    if 2 * grasp.sliding > grasp.points { ", slips" } else { "" }
}
