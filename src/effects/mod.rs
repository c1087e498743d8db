//! Effects: one physical error source per file, each defined once for the simulator, the fit and the plots. Pure.
//!
//! In: an effect's parameters (contract, section 5), a rate, a random stream. Out: what is known about it in closed form
//! (power spectrum, Allan variance, mean response) and a sampler that streams it in bounded memory.
//!
//! Every effect samples from a stream of its own ([`stream`]), so that adding one never changes another's values.
//! A sampler works on blocks in place and its values do not depend on how the stream is cut into blocks.
//!
//! | effect | two-sided PSD | Allan variance of sampled data |
//! |---|---|---|
//! | [`White`] (N) | N² | N²/τ |
//! | [`Flicker`] (B) | B²/(2πf) | (2 ln 2/π)·B² + O(ln m/m²) |
//! | [`RandomWalk`] (K) | (K/2πf)² | K²·dt·(2m²+1)/(6m) |

#[cfg(test)]
mod check;
pub mod flicker;
pub mod random_walk;
pub mod stream;
pub mod white;

pub use flicker::Flicker;
pub use random_walk::RandomWalk;
pub use stream::{Stream, StreamId};
pub use white::White;

/// One error source. U is the unit of the channel it acts on.
pub trait Effect: std::fmt::Debug + Send + Sync {
    /// The name in files and messages (contract, section 5).
    fn name(&self) -> &'static str;

    /// Two-sided power spectral density in U²/Hz at `frequency_hz` (above 0, up to `rate_hz`/2) of the effect sampled at
    /// `rate_hz`; 0 for an effect without a continuous spectrum.
    fn psd(&self, frequency_hz: f64, rate_hz: f64) -> f64;

    /// Expected overlapping Allan variance in U² at the averaging time `m`/`rate_hz` (`m` from 1) of the effect sampled at
    /// `rate_hz`.
    fn allan_variance(&self, m: u64, rate_hz: f64) -> f64;

    /// What the channel shows on average, `time_s` after the start, where it would show `input` (U) without the effect.
    fn mean_response(&self, input: f64, time_s: f64) -> f64 {
        let _ = time_s;
        input
    }

    /// A sampler at `rate_hz` that draws from `stream`. Spectra hold down to 1/`record_length_s`; a longer record may be
    /// drawn, its lowest frequencies are then not promised.
    fn sampler(&self, rate_hz: f64, record_length_s: f64, stream: Stream) -> Box<dyn Sampler>;
}

/// A realisation of an effect: memory is bounded however long it runs.
pub trait Sampler: std::fmt::Debug + Send {
    /// Lets the effect act on the next `values.len()` samples of its channel (U), in place.
    fn apply(&mut self, values: &mut [f64]);
}
