//! What was let go of and fell.

/// How far a thing must fall after it was let go of to have been dropped, m. The examination counts what falls out of view; on a board everything stays in
/// view, so that a fall by more than what lies between a ring's edge and its peg counts here.
pub const FALL_M: f64 = 0.010;

/// One thing that jaws may hold.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Carried {
    /// Not held since it last came to rest.
    #[default]
    Free,
    /// Held by jaws alone.
    Held {
        /// Height when last seen, m.
        height_m: f64,
    },
    /// Let go of, and not at rest yet.
    LetGo {
        /// Height at which it was let go of, m.
        from_m: f64,
    },
}

impl Carried {
    /// Takes what is seen now: whether jaws hold it and nothing else does, its height (m), and whether it is at rest. Gives whether it has just been dropped: it has fallen by
    /// more than [`FALL_M`] below where it was let go of.
    pub fn see(&mut self, held: bool, height_m: f64, at_rest: bool) -> bool {
        *self = match *self {
            _ if held => Self::Held { height_m },
            Self::Held { height_m: from_m } | Self::LetGo { from_m } if from_m - height_m > FALL_M => {
                *self = Self::Free;
                return true;
            }
            Self::LetGo { .. } if at_rest => Self::Free,
            Self::Held { height_m: from_m } => Self::LetGo { from_m },
            other => other,
        };
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of a way of heights (mm), held where `h`, at rest where `.`.
    fn drops(way: &[(f64, char)]) -> u32 {
        let mut carried = Carried::default();
        way.iter().map(|(mm, how)| u32::from(carried.see(*how == 'h', mm * 1e-3, *how == '.'))).sum()
    }

    #[test]
    fn only_what_falls_after_it_was_let_go_of_is_dropped() {
        assert_eq!(drops(&[(5.0, '.'), (5.0, 'h'), (45.0, 'h'), (11.0, 'h'), (8.0, ' '), (5.0, '.')]), 0, "put down");
        assert_eq!(drops(&[(45.0, 'h'), (40.0, ' '), (30.0, ' '), (5.0, ' '), (5.0, '.')]), 1, "dropped once");
        assert_eq!(drops(&[(45.0, 'h'), (20.0, ' '), (5.0, '.'), (5.0, 'h'), (45.0, 'h'), (5.0, '.')]), 2, "twice");
        assert_eq!(drops(&[(45.0, 'h'), (40.0, ' '), (36.0, 'h'), (20.0, 'h'), (12.0, ' ')]), 0, "caught");
        assert_eq!(drops(&[(45.0, ' '), (5.0, ' ')]), 0, "nobody held it");
        assert_eq!(drops(&[(45.0, 'h'), (44.0, ' '), (44.0, '.'), (5.0, ' ')]), 0, "it came to rest before something else let it fall");
    }
}
