//! The filmed beam as a table and as a part of the page.

use crate::study::StudyError;
use crate::study::film::Take;
use crate::study::filmed::{Filmed, FilmedRow, Who};
use crate::study::markup::{cell, table, verdict};
use maud::{Markup, html};
use std::path::Path;

/// Part of the filmed response and of the filmed period within which the reference is sought.
pub const SOUGHT: (f64, f64) = (0.05, 0.03);

fn signed(part: Option<f64>) -> String {
    part.map(|p| format!("{:+.1} %", p * 100.0)).unwrap_or_default()
}

impl Filmed {
    /// Writes the table.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), StudyError> {
        let named = |source| StudyError::Table { path: path.into(), source };
        let mut writer = csv::Writer::from_path(path).map_err(named)?;
        let header = ["who", "tets", "load_n", "displacement_mm", "error", "response_error", "period_s", "period_error", "damping_ratio"];
        writer.write_record(header).map_err(named)?;
        let number = |x: Option<f64>| x.map(|x| format!("{x:.4}")).unwrap_or_default();
        for film in &self.films {
            for (take, t) in film.takes.iter().enumerate() {
                let name = format!("film {}", ["a", "b"].get(take).copied().unwrap_or("?"));
                let figures = [Some(t.sag_mm), None, None, Some(t.period_s), None, Some(t.damping)].map(number);
                let record = [name, String::new(), film.load_n.to_string()].into_iter().chain(figures);
                writer.write_record(record).map_err(named)?;
            }
        }
        for r in &self.rows {
            let (error, response) = (self.error(r), self.response_error(r));
            let figures = [Some(r.sag_mm), error, response, r.swing.map(|s| s.0), self.period_error(r), r.swing.map(|s| s.1)].map(number);
            let record = [r.who.name(), r.tets.to_string(), r.load_n.to_string()].into_iter().chain(figures);
            writer.write_record(record).map_err(named)?;
        }
        writer.flush().map_err(|e| named(e.into()))
    }

    /// For the page.
    #[must_use]
    pub fn markup(&self) -> Markup {
        let films: Vec<Vec<Markup>> = self
            .films
            .iter()
            .map(|film| {
                let each = |f: fn(&Take) -> String| film.takes.iter().map(f).collect::<Vec<_>>().join(" / ");
                vec![
                    cell(film.load_n),
                    cell(each(|t| format!("{:.2}", t.sag_mm))),
                    cell(each(|t| format!("{:.3}", t.period_s))),
                    cell(each(|t| format!("{:.3}", t.damping))),
                ]
            })
            .collect();
        let rows: Vec<Vec<Markup>> = self
            .rows
            .iter()
            .map(|r| {
                vec![
                    cell(r.who.name()),
                    cell(r.tets),
                    cell(r.load_n),
                    cell(format!("{:.2}", r.sag_mm)),
                    cell(signed(self.error(r))),
                    cell(signed(self.response_error(r))),
                    cell(r.swing.map(|s| format!("{:.3}", s.0)).unwrap_or_default()),
                    cell(signed(self.period_error(r))),
                    cell(r.swing.map(|s| format!("{:.3}", s.1)).unwrap_or_default()),
                ]
            })
            .collect();
        html! {
            p {
                "Silicone, E 263 824 Pa as its publishers fitted it, nu 0.499, 1070 kg/m3, 100 x 30 x 30 mm, filmed by motion capture in two takes of each load. The load is a weight at the lower edge of the end and moves "
                "along. Nothing is fitted here but two constants of damping, drag " (format!("{:.2}", self.rayleigh.0)) " 1/s and viscosity " (format!("{:.2}", self.rayleigh.1 * 1e3)) " ms, which give the filmed damping ratios under no load and under the largest; "
                "the one between is foretold."
            }
            (table(&["load beside gravity, N", "filmed displacement, mm", "period, s", "damping ratio"], &films))
            (self.conclusion())
            (table(&["who", "tets", "load, N", "displacement, mm", "against the film", "response to the load", "period, s", "against the film", "damping ratio"], &rows))
            p {
                "Response: what the load adds to the displacement under gravity, against what it adds in the film. The reference's period is that of its slowest mode about the loaded shape, and its damping ratio Rayleigh's at that period; the models swing from straight, with ticks of 1/60 s. Models other than the implicit one know drag alone, and get "
                "that which damps the film of the same load."
            }
        }
    }

    /// What agrees, and what is in the way where something does not.
    fn conclusion(&self) -> Markup {
        let stiff_rows = self.finest(Who::Quadratic);
        let coarser = |r: &&&FilmedRow| self.rows.iter().find(|c| c.who == r.who && c.load_n == r.load_n && c.tets < r.tets);
        let apart = stiff_rows.iter().filter_map(|r| Some((r.sag_mm / coarser(&r)?.sag_mm - 1.0).abs())).fold(0.0, f64::max);
        let locked = self.finest(Who::Linear).iter().zip(&stiff_rows).map(|(a, b)| a.sag_mm / b.sag_mm - 1.0).fold(0.0, f64::min);
        let worst = |errors: Vec<Option<f64>>| errors.into_iter().flatten().fold(0.0, |w: f64, e| if e.abs() > w.abs() { e } else { w });
        let of = |rows: &[&FilmedRow], f: &dyn Fn(&FilmedRow) -> Option<f64>| worst(rows.iter().map(|r| f(r)).collect());
        let response = of(&stiff_rows, &|r| self.response_error(r));
        let displaced = of(&stiff_rows, &|r| self.error(r));
        let period = of(&stiff_rows, &|r| self.period_error(r));
        let scatter = self
            .films
            .iter()
            .map(|f| {
                let sags = f.takes.iter().map(|t| t.sag_mm);
                (sags.clone().fold(0.0, f64::max) - sags.fold(f64::INFINITY, f64::min)) / f.mean(|t| t.sag_mm)
            })
            .fold(0.0, f64::max);
        let (sought, sought_period) = SOUGHT;
        html! {
            ul {
                li {
                    "Ten-node elements move by " (format!("{:.1} %", apart * 100.0)) " when the mesh is made twice as fine. "
                    "Linear elements are up to " (format!("{:.1} %", -locked * 100.0)) " too stiff on theirs: they lock."
                }
                li { "Displacement in equilibrium, ten-node elements: at worst " (signed(Some(displaced))) " off the film; response to load " (signed(Some(response))) ": " (verdict(response.abs() <= sought)) " within " (format!("{:.0} %", sought * 100.0)) "." }
                li { "Period, ten-node elements: at worst " (signed(Some(period))) " off: " (verdict(period.abs() <= sought_period)) " within " (format!("{:.0} %", sought_period * 100.0)) "." }
                @if response.abs() > sought && period.abs() <= sought_period {
                    li {
                        "The periods under the very same weights agree and what the weights add at rest does not, so against a swing the stiffness is right and against a standing load the beam in the film gives way more: silicone creeps under it, or the weight hangs further out than the "
                        "edge. A softer material would put this right and the periods wrong."
                    }
                }
                li {
                    "What no model can take out: two takes of one load are up to " (format!("{:.1} %", scatter * 100.0)) " apart; where along the beam the markers stand is not published, and a millimetre of it is a displacement of more than a hundredth; "
                    "silicone creeps, and its damping is nearly the same at all periods, which Rayleigh's is not."
                }
            }
        }
    }
}
