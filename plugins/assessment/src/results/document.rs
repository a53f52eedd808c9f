//! What the pages are made of.

use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = "body{font:16px/1.45 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}\
table{border-collapse:collapse;margin:1em 0;font-size:14px;font-variant-numeric:tabular-nums}\
td,th{border:1px solid #ccc;padding:.25em .6em;text-align:right;vertical-align:top}td:first-child,th:first-child,td.text{text-align:left}th{background:#f3f3f3}\
svg{max-width:100%;height:auto;border:1px solid #ddd}figure{margin:1.5em 0}figcaption{font-size:14px;color:#444}\
.yes{color:#06703f;font-weight:600}.no{color:#a33000;font-weight:600}";

/// A page that needs no other file.
pub(crate) fn frame(title: &str, body: &Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head { meta charset="utf-8"; title { (title) } style { (PreEscaped(STYLE)) } }
            body { h1 { (title) } (body) }
        }
    }
    .into_string()
}

/// A drawing with what stands below it.
pub(crate) fn figure(svg: &str, caption: &str) -> Markup {
    html! { figure { (PreEscaped(svg)) figcaption { (caption) } } }
}

/// A figure as it stands on the pages: three digits, no more than are needed.
#[must_use]
pub fn number(v: f64) -> String {
    if v == 0.0 || !v.is_finite() {
        return if v == 0.0 { "0".into() } else { "–".into() };
    }
    let digits = (2 - v.abs().log10().floor() as i32).clamp(0, 6) as usize;
    let text = format!("{v:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// A time as `2026-11-22 13:05 UTC`. Days to dates as in Hinnant's `civil_from_days`.
pub(crate) fn date(unix_s: u64) -> String {
    let (days, of_day) = (unix_s / 86_400, unix_s % 86_400);
    // Eras of 400 years from 0000-03-01, so that a leap day is the last of its year.
    let shifted = days + 719_468;
    let (era, day) = (shifted / 146_097, shifted % 146_097);
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let of_year = day - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 { (month + 3, 0) } else { (month - 9, 1) };
    format!("{:04}-{month:02}-{day:02} {:02}:{:02} UTC", era * 400 + year + next, of_day / 3600, of_day / 60 % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_and_numbers() {
        let days = [(0, "1970-01-01 00:00 UTC"), (951_782_340, "2000-02-28 23:59 UTC"), (951_782_400, "2000-02-29 00:00 UTC")];
        for (unix, text) in days.into_iter().chain([(4_107_542_400, "2100-03-01 00:00 UTC"), (1_795_353_900, "2026-11-22 13:25 UTC")]) {
            assert_eq!(date(unix), text);
        }
        assert_eq!([0.0, 1.0, 0.25, 1234.5, -2.5, f64::NAN].map(number), ["0", "1", "0.25", "1234", "-2.5", "–"]);
    }
}
