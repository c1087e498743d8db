//! Plans: transforms of the lengths in use. Each thread keeps them, because planning one takes as long as running it.
//!
//! Each length has a planner of its own: a planner builds on what it planned before, so that the rounding of a transform
//! would depend on the lengths that were used before it.

use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

/// Maximum number of kept lengths; one more length discards all of them.
const MOST: usize = 24;

/// cos and sin of πk/2n for k up to n/2.
pub(super) type Turns = Arc<[(f64, f64)]>;

#[derive(Default)]
struct Plans {
    forward: BTreeMap<usize, Arc<dyn RealToComplex<f64>>>,
    backward: BTreeMap<usize, Arc<dyn ComplexToReal<f64>>>,
    turns: BTreeMap<usize, Turns>,
}

thread_local! {
    static PLANS: RefCell<Plans> = RefCell::default();
}

impl Plans {
    fn forget(&mut self) {
        if self.forward.len() + self.backward.len() + self.turns.len() > 3 * MOST {
            *self = Self::default();
        }
    }
}

/// Returns the transform from `n` real values.
pub(super) fn forward(n: usize) -> Arc<dyn RealToComplex<f64>> {
    PLANS.with_borrow_mut(|plans| {
        plans.forget();
        plans.forward.entry(n).or_insert_with(|| RealFftPlanner::new().plan_fft_forward(n)).clone()
    })
}

/// Returns the transform to `n` real values.
pub(super) fn backward(n: usize) -> Arc<dyn ComplexToReal<f64>> {
    PLANS.with_borrow_mut(|plans| {
        plans.forget();
        plans.backward.entry(n).or_insert_with(|| RealFftPlanner::new().plan_fft_inverse(n)).clone()
    })
}

/// Returns the tables of a cosine transform of length `n`.
pub(super) fn turns(n: usize) -> Turns {
    PLANS.with_borrow_mut(|plans| {
        plans.forget();
        let step = PI / (2.0 * n as f64);
        let turn = |k: usize| {
            let (sine, cosine) = (k as f64 * step).sin_cos();
            (cosine, sine)
        };
        plans.turns.entry(n).or_insert_with(|| (0..=n / 2).map(turn).collect()).clone()
    })
}
