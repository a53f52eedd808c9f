//! Forces: of the jaws on what they hold, of a tool on tissue, and what of them is too much.

/// Sums over the forces of one instrument.
#[derive(Clone, Copy, Debug)]
pub struct ForceWatch {
    dt_s: f64,
    /// A grip beyond this does harm, N.
    limit_n: f64,
    grip: Mean,
    tissue: Mean,
    overload_n_s: f64,
}

/// Mean and greatest over the samples in which there was something.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    samples: u64,
    sum: f64,
    most: f64,
}

impl Mean {
    fn push(&mut self, value: f64) {
        self.samples += 1;
        self.sum += value;
        self.most = self.most.max(value);
    }

    fn mean(&self) -> Option<f64> {
        (self.samples > 0).then(|| self.sum / self.samples as f64)
    }

    fn most(&self) -> Option<f64> {
        (self.samples > 0).then_some(self.most)
    }
}

impl ForceWatch {
    /// Nothing seen yet. `dt_s` is the time between samples; a grip beyond `limit_n` does harm.
    #[must_use]
    pub fn new(dt_s: f64, limit_n: f64) -> Self {
        Self { dt_s, limit_n, grip: Mean::default(), tissue: Mean::default(), overload_n_s: 0.0 }
    }

    /// Takes a sample: the force of each jaw on what they hold, N, `None` while they hold nothing; and the force on tissue, N, zero while the tool touches
    /// none.
    pub fn push(&mut self, grip_n: Option<f64>, tissue_n: f64) {
        if let Some(grip) = grip_n {
            self.grip.push(grip);
            self.overload_n_s += (grip - self.limit_n).max(0.0) * self.dt_s;
        }
        if tissue_n > 0.0 {
            self.tissue.push(tissue_n);
        }
    }

    /// Mean grip while something was held, N.
    #[must_use]
    pub fn grip_mean_n(&self) -> Option<f64> {
        self.grip.mean()
    }

    /// Greatest grip, N.
    #[must_use]
    pub fn grip_max_n(&self) -> Option<f64> {
        self.grip.most()
    }

    /// Mean force on tissue while it was touched, N.
    #[must_use]
    pub fn tissue_mean_n(&self) -> Option<f64> {
        self.tissue.mean()
    }

    /// Greatest force on tissue, N.
    #[must_use]
    pub fn tissue_max_n(&self) -> Option<f64> {
        self.tissue.most()
    }

    /// Grip beyond the limit, summed over time, N s.
    #[must_use]
    pub fn overload_n_s(&self) -> f64 {
        self.overload_n_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In steps of 0.1 s: grips of 1, 3, 8 and 6 N with a limit of 5 N are `(3 + 1) * 0.1 = 0.4` N s too much; tissue is touched twice.
    #[test]
    fn grips_and_overload_by_hand() {
        let mut force = ForceWatch::new(0.1, 5.0);
        assert_eq!((force.grip_mean_n(), force.tissue_max_n()), (None, None));
        for (grip, tissue) in [(None, 0.0), (Some(1.0), 2.0), (Some(3.0), 4.0), (Some(8.0), 0.0), (Some(6.0), 0.0)] {
            force.push(grip, tissue);
        }
        assert_eq!((force.grip_mean_n(), force.grip_max_n()), (Some(4.5), Some(8.0)));
        assert_eq!((force.tissue_mean_n(), force.tissue_max_n()), (Some(3.0), Some(4.0)));
        assert!((force.overload_n_s() - 0.4).abs() < 1e-12);
    }
}
