//! The table of all metrics: what each means, its unit and where it comes from. The results page prints it.

use serde::{Deserialize, Serialize};

/// A metric by name, as it stands in files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[expect(missing_docs, reason = "the table says what each is")]
pub enum MetricId {
    Time,
    PathLength,
    Depth,
    Speed,
    Smoothness,
    Idle,
    OutOfView,
    GripMean,
    GripMax,
    TissueForceMean,
    TissueForceMax,
    Overload,
    Bruised,
    StitchesTorn,
    ToolCollisions,
    Dropped,
    OffTheLine,
    Horizon,
    Centring,
    Distance,
    BloodLoss,
    Aspirated,
    ClipErrors,
    ClampTime,
    TumourLeft,
    HealthyRemoved,
    Preserved,
    MarginLeast,
    MarginMean,
    MarginMedian,
    MarginPositive,
    CutSurface,
}

/// What a figure is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// One hand.
    Hand,
    /// The endoscope.
    Camera,
    /// The whole session.
    Session,
    /// What was resected.
    Resection,
}

/// Which way is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// Smaller figures.
    Less,
    /// Greater figures.
    More,
    /// Neither by itself.
    Neither,
}

/// What a metric is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metric {
    /// Name for reading.
    pub name: &'static str,
    /// Unit of the figures in files and on pages.
    pub unit: &'static str,
    /// What it is about.
    pub scope: Scope,
    /// Which way is better.
    pub better: Better,
    /// What it means.
    pub definition: &'static str,
    /// Where it comes from.
    pub source: &'static str,
}

const COTIN: &str = "Cotin et al. 2002, doi 10.1007/3-540-45786-0_5";
const SMOOTHNESS: &str =
    "Balasubramanian et al. 2015, doi 10.1186/s12984-015-0090-9; that it tells skill where mean jerk does not: Sensors 2023, 23:3146";
const VIEW: &str = "Time outside of the camera's view, among the features reviewed in doi 10.1007/s00464-017-5873-6";
const CAMERA: &str = "Horizon, centring and distance are what those who hold the camera are judged by; the definitions are ours";
const NEPHRECTOMY: &str =
    "How partial nephrectomy is judged: margin, ischaemia, renal function, blood loss (Hung et al. 2013, Journal of Urology 189:36)";
const OURS: &str = "Own definition";

impl MetricId {
    /// All, in the order in which they are shown.
    pub const ALL: [Self; 32] = [
        Self::Time,
        Self::PathLength,
        Self::Depth,
        Self::Speed,
        Self::Smoothness,
        Self::Idle,
        Self::OutOfView,
        Self::GripMean,
        Self::GripMax,
        Self::TissueForceMean,
        Self::TissueForceMax,
        Self::Overload,
        Self::Bruised,
        Self::StitchesTorn,
        Self::ToolCollisions,
        Self::Dropped,
        Self::OffTheLine,
        Self::Horizon,
        Self::Centring,
        Self::Distance,
        Self::BloodLoss,
        Self::Aspirated,
        Self::ClipErrors,
        Self::ClampTime,
        Self::TumourLeft,
        Self::HealthyRemoved,
        Self::Preserved,
        Self::MarginLeast,
        Self::MarginMean,
        Self::MarginMedian,
        Self::MarginPositive,
        Self::CutSurface,
    ];

    /// Its name in files.
    #[must_use]
    pub fn id(self) -> String {
        let quoted = serde_json::to_string(&self).unwrap_or_default();
        quoted.trim_matches('"').to_owned()
    }

    /// What it is.
    #[must_use]
    pub fn metric(self) -> Metric {
        use Better::{Less, More, Neither};
        use Scope::{Camera, Hand, Resection, Session};
        let of = |name, unit, scope, better, definition, source| Metric { name, unit, scope, better, definition, source };
        match self {
            Self::Time => of("Time", "s", Session, Less, "Simulated time from the start of the scene; pauses do not count.", COTIN),
            Self::PathLength => {
                of("Path length", "mm", Hand, Less, "Length of the way of the tool's tip, tick by tick, unsmoothed.", COTIN)
            }
            Self::Depth => of(
                "Depth",
                "mm",
                Hand,
                Less,
                "Length of the tip's way along its shaft, in and out: the changes of its distance from the port, summed.",
                COTIN,
            ),
            Self::Speed => of("Mean speed", "mm/s", Hand, Neither, "Path length by time.", COTIN),
            Self::Smoothness => of(
                "Log dimensionless jerk",
                "1",
                Hand,
                More,
                "-ln(T^3 / v^2 * integral |x'''|^2 dt) over the session of length T with the peak speed v. Derivatives are those of a cubic fitted to nine samples by least squares, 0.15 s at 60 Hz. The smoothest single movement has -5.3; a long session of many movements has far less.",
                SMOOTHNESS,
            ),
            Self::Idle => of(
                "Idle time",
                "s",
                Hand,
                Less,
                "Time in which the tip was slower than 5 mm/s for half a second or longer; the bounds are ours.",
                "D'Angelo et al. 2015, doi 10.1016/j.amjsurg.2014.12.013",
            ),
            Self::OutOfView => of(
                "Time out of view",
                "s",
                Hand,
                Less,
                "Time in which the tip was outside of the endoscope's angle of view. What hides behind tissue counts as seen.",
                VIEW,
            ),
            Self::GripMean => of(
                "Mean grip",
                "N",
                Hand,
                Less,
                "Force of each jaw on what is between them, mean over the time in which something was held.",
                "Grip force: Sensors 2023, 23:3146",
            ),
            Self::GripMax => of(
                "Greatest grip",
                "N",
                Hand,
                Less,
                "The greatest force of each jaw on what is between them.",
                "Grip force: Sensors 2023, 23:3146",
            ),
            Self::TissueForceMean => of(
                "Mean force on tissue",
                "N",
                Hand,
                Less,
                "Force of the tool on all tissue, contact and pull together, mean over the time in which it was above zero.",
                "Trejos et al. 2014, doi 10.1007/s00464-014-3442-9",
            ),
            Self::TissueForceMax => of(
                "Greatest force on tissue",
                "N",
                Hand,
                Less,
                "The greatest force of the tool on all tissue.",
                "Trejos et al. 2014, doi 10.1007/s00464-014-3442-9",
            ),
            Self::Overload => of(
                "Tissue damage",
                "N s",
                Hand,
                Less,
                "Grip beyond the limit that does harm, summed over time: damage grows with the stress of a grasp and with its duration. The limit is a setting, 5 N unless told.",
                "After De et al. 2007, International Journal of Robotics Research 26:1159; measure and limit are ours",
            ),
            Self::Bruised => of(
                "Tissue bruised",
                "mm2",
                Session,
                Less,
                "Area under the pads of graspers that pressed harder than the tissue bears; each part of a pad counts once a grasp. Where the scene says nothing tissue bears 250 kPa.",
                "Damage by pinching: Heijnsdijk et al. 2004, PMID 15108111; the measure is ours",
            ),
            Self::StitchesTorn => of("Stitches torn out", "", Session, Less, "Bites of a needle that the thread has torn out.", OURS),
            Self::ToolCollisions => of(
                "Tool collisions",
                "",
                Session,
                Less,
                "How often two instruments began to touch inside the body; touches less than 0.1 s apart are one.",
                "Tool collisions: a common metric of simulators; the 0.1 s are ours",
            ),
            Self::Dropped => of(
                "Dropped",
                "",
                Session,
                Less,
                "How often something that nothing but jaws held was let go of and fell by more than 10 mm.",
                "Objects dropped are an error of FLS; the 10 mm are ours",
            ),
            Self::OffTheLine => of(
                "Off the line",
                "mm",
                Session,
                Less,
                "The largest distance of the rim of what was cut out from the circle that it was to be cut along, in the rest shape.",
                "The error of FLS's pattern cut: Ritter & Scott 2007, doi 10.1177/1553350607302329",
            ),
            Self::Horizon => {
                of("Horizon", "degrees", Camera, Less, "Angle between the picture's horizontal and the horizon, mean over time.", CAMERA)
            }
            Self::Centring => of(
                "Off centre",
                "1",
                Camera,
                Less,
                "Angle from the middle of the picture to the middle between the tips, by half of the angle of view: 0 in the middle, 1 at the rim; mean over time.",
                CAMERA,
            ),
            Self::Distance => of(
                "Distance",
                "mm",
                Camera,
                Neither,
                "From the endoscope's tip to the middle between the tools' tips, mean over time.",
                CAMERA,
            ),
            Self::BloodLoss => of("Blood loss", "ml", Session, Less, "Blood that was lost through all bleeding sites.", NEPHRECTOMY),
            Self::Aspirated => of("Blood aspirated", "ml", Session, Neither, "What of the lost blood a suction has taken up.", OURS),
            Self::ClipErrors => of(
                "Clip errors",
                "",
                Session,
                Less,
                "Clips that were set on no vessel or not across the whole of one, that closed on nothing and dropped, or that slipped off.",
                OURS,
            ),
            Self::ClampTime => of(
                "Clamp time",
                "s",
                Resection,
                Less,
                "Time in which the vessels that supply the organ were clamped: warm ischaemia.",
                NEPHRECTOMY,
            ),
            Self::TumourLeft => {
                of("Tumour left behind", "ml", Resection, Less, "Tumour that has not come free, in the rest shape.", NEPHRECTOMY)
            }
            Self::HealthyRemoved => of(
                "Healthy tissue removed",
                "ml",
                Resection,
                Less,
                "Healthy tissue that came free or that a blade took away, in the rest shape.",
                NEPHRECTOMY,
            ),
            Self::Preserved => {
                of("Preserved parenchyma", "%", Resection, More, "Healthy tissue that stays, as a part of what there was.", NEPHRECTOMY)
            }
            Self::MarginLeast => of(
                "Least margin",
                "mm",
                Resection,
                More,
                "The least distance from the surface that was cut, on what came free, to the tumour in it; in the rest shape.",
                NEPHRECTOMY,
            ),
            Self::MarginMean => of("Mean margin", "mm", Resection, Neither, "The same distance, mean over the area.", OURS),
            Self::MarginMedian => {
                of("Median margin", "mm", Resection, Neither, "The same distance, which half of the area does not exceed.", OURS)
            }
            Self::MarginPositive => of(
                "Positive margin",
                "%",
                Resection,
                Less,
                "The part of that surface's area at vertices where the cut goes through tumour.",
                NEPHRECTOMY,
            ),
            Self::CutSurface => of("Cut surface", "mm2", Resection, Neither, "The area of that surface.", OURS),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_metric_is_listed_once_and_says_what_it_is() {
        let ids: BTreeSet<MetricId> = MetricId::ALL.into_iter().collect();
        assert_eq!(ids.len(), MetricId::ALL.len());
        // The last of the enum is the last of the list, so none is missing.
        assert_eq!(MetricId::CutSurface as usize + 1, MetricId::ALL.len());
        let mut names = BTreeSet::new();
        for id in MetricId::ALL {
            let metric = id.metric();
            assert!(names.insert(metric.name) && !metric.source.is_empty() && metric.definition.ends_with('.'), "{metric:?}");
        }
        assert_eq!(MetricId::OutOfView.id(), "out_of_view");
    }
}
