//! The figures of a session, and the files that keep them.

use crate::metrics::{Margin, MetricId};
use crate::results::tasks::TaskResult;
use keyhole_whiteboard::Hand;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Version of the files' format.
pub const FORMAT: u32 = 1;

/// The results of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Results {
    /// [`FORMAT`].
    pub format: u32,
    /// Version of the program.
    pub program: String,
    /// Name of the scene.
    pub scene: String,
    /// Who was at the table; empty when nobody said.
    #[serde(default)]
    pub trainee: String,
    /// When the session ended, s since 1970-01-01 00:00 UTC.
    pub ended_unix_s: u64,
    /// The figures.
    pub figures: Vec<Measured>,
    /// How the scene's task was done; `None` where there is none.
    #[serde(default)]
    pub task: Option<TaskResult>,
    /// The distribution of the margin over the surface that was cut.
    #[serde(default)]
    pub margin: Option<MarginSummary>,
}

/// A figure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// What it is.
    pub metric: MetricId,
    /// The hand it is of; `None` for what is of no hand.
    #[serde(with = "hand")]
    pub hand: Option<Hand>,
    /// The figure, in the metric's unit.
    pub value: f64,
}

/// How a margin is distributed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MarginSummary {
    /// Width of a class, mm.
    pub class_mm: f64,
    /// Parts of the area by classes, from 0 mm on; together 1.
    pub classes: Vec<f64>,
}

impl MarginSummary {
    /// Of a margin, in classes of a millimetre.
    #[must_use]
    pub fn of(margin: &Margin) -> Self {
        let class_mm = 1.0;
        let mut classes = Vec::new();
        let area = margin.area_m2();
        for vertex in &margin.vertices {
            let class = (vertex.margin_m * 1e3 / class_mm) as usize;
            if classes.len() <= class {
                classes.resize(class + 1, 0.0);
            }
            classes[class] += vertex.area_m2 / area;
        }
        Self { class_mm, classes }
    }
}

impl Results {
    /// A figure; of a metric of hands the hand must be given.
    #[must_use]
    pub fn value(&self, metric: MetricId, hand: Option<Hand>) -> Option<f64> {
        self.figures.iter().find(|m| m.metric == metric && m.hand == hand).map(|m| m.value)
    }

    /// As JSON.
    #[must_use]
    pub fn json(&self) -> String {
        // A structure of numbers and text can always be written; a figure that is not finite becomes null.
        serde_json::to_string_pretty(self).unwrap_or_default() + "\n"
    }

    /// As CSV: `metric,hand,value,unit`, a line a figure; then of a task its `score`, and of each goal, named `goal: NAME`, whether it was met: 1 or 0.
    ///
    /// # Errors
    /// None in practice: it is written to memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(["metric", "hand", "value", "unit"])?;
        for m in &self.figures {
            writer.write_record([m.metric.id().as_str(), hand_name(m.hand), &m.value.to_string(), m.metric.metric().unit])?;
        }
        if let Some(task) = &self.task {
            if let Some(score) = &task.score {
                writer.write_record(["score", "", &score.score.to_string(), "of 100"])?;
            }
            for goal in &task.goals {
                writer.write_record([format!("goal: {}", goal.name).as_str(), "", if goal.met { "1" } else { "0" }, "met"])?;
            }
        }
        let bytes = writer.into_inner().map_err(|e| e.into_error())?;
        Ok(String::from_utf8_lossy(&bytes).into_owned())
    }

    /// Writes `results.json`, `results.csv` and `results.html` into a folder that is there, each under a temporary name first.
    ///
    /// # Errors
    /// When one of them cannot be written, or a plot not be drawn.
    pub fn write(&self, folder: &Path, margin: Option<&Margin>) -> std::io::Result<()> {
        put(folder, "results.json", &self.json())?;
        put(folder, "results.csv", &self.csv().map_err(std::io::Error::other)?)?;
        put(folder, "results.html", &super::page(self, margin).map_err(std::io::Error::other)?)
    }
}

/// Writes a file under a temporary name and gives it its own.
pub(crate) fn put(folder: &Path, name: &str, text: &str) -> std::io::Result<()> {
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    std::io::Write::write_all(&mut file, text.as_bytes())?;
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        file.as_file().set_permissions(std::fs::Permissions::from_mode(0o644))?;
    }
    file.persist(folder.join(name))?;
    Ok(())
}

/// `left`, `right`, or nothing.
pub(crate) fn hand_name(hand: Option<Hand>) -> &'static str {
    match hand {
        Some(Hand::Left) => "left",
        Some(Hand::Right) => "right",
        None => "",
    }
}

/// Hands in files.
mod hand {
    use super::{Hand, hand_name};
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    #[expect(clippy::ref_option, reason = "what serde calls")]
    pub fn serialize<S: Serializer>(hand: &Option<Hand>, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(hand_name(*hand))
    }

    pub fn deserialize<'a, D: Deserializer<'a>>(from: D) -> Result<Option<Hand>, D::Error> {
        match String::deserialize(from)?.as_str() {
            "left" => Ok(Some(Hand::Left)),
            "right" => Ok(Some(Hand::Right)),
            "" => Ok(None),
            other => Err(D::Error::custom(format!("{other:?} is no hand: expected \"left\", \"right\" or \"\""))),
        }
    }
}
