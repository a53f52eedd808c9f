//! What the settings of the start screen cost in accuracy and in time. The figures stand in one file, `costs.csv`, each with its source.

/// A choice of a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Choice {
    /// Which setting: `method` or `quality`.
    pub kind: &'static str,
    /// The choice's name.
    pub name: &'static str,
    /// What it is worth.
    pub accuracy: &'static str,
    /// What it costs.
    pub cost: &'static str,
    /// Where the figures come from.
    pub source: &'static str,
}

const FILE: &str = include_str!("costs.csv");

/// The choices of a setting, in the order of the file.
pub fn choices(kind: &str) -> impl Iterator<Item = Choice> {
    FILE.lines().filter_map(parse).filter(move |choice| choice.kind == kind)
}

/// `None` for a comment.
fn parse(line: &'static str) -> Option<Choice> {
    let mut fields = line.split(';').map(str::trim);
    let mut next = || fields.next().filter(|field| !field.is_empty());
    let kind = next().filter(|kind| !kind.starts_with('#'))?;
    Some(Choice { kind, name: next()?, accuracy: next()?, cost: next()?, source: next()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_that_is_no_comment_is_a_choice() {
        let lines = FILE.lines().filter(|line| !line.starts_with('#')).count();
        assert_eq!(choices("method").count() + choices("quality").count(), lines);
        let methods: Vec<&str> = choices("method").map(|c| c.name).collect();
        assert_eq!(methods, ["hybrid", "progressive", "non-progressive"]);
        assert_eq!(choices("quality").next().map(|c| c.name), Some("as the scene says"));
    }
}
