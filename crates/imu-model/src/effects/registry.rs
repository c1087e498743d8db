//! Every effect under its name: the one list that files are read by and that messages, schema and tables are made of.

use super::spec::{Kind, Spec};
use super::{Effect, TriadEffect, triad};

/// Effects on a channel, in the documented order.
pub static CHANNEL: [&Kind<dyn Effect>; 25] = [
    &super::resolution::KIND,
    &super::quantization_noise::KIND,
    &super::rate_ramp::KIND,
    &super::gauss_markov::KIND,
    &super::tone::TONE,
    &super::tone::COMB,
    &super::resonance::KIND,
    &super::temperature_bias::KIND,
    &super::warm_up::KIND,
    &super::spikes::KIND,
    &super::heavy_tails::KIND,
    &super::bias_step::KIND,
    &super::bursts::KIND,
    &super::variance_change::KIND,
    &super::low_pass::KIND,
    &super::moving_average::KIND,
    &super::saturation::KIND,
    &super::held_samples::KIND,
    &super::common_mode::KIND,
    &super::timing::KIND,
    &super::power_law::KIND,
    &super::spectrum::KIND,
    &super::modulated_band::KIND,
    &super::intermittent::KIND,
    &super::wandering_line::KIND,
];

/// Effects on a triad, in the documented order.
pub static TRIAD: [&Kind<dyn TriadEffect>; 8] = [
    &triad::bias::KIND,
    &triad::scale_factor::KIND,
    &triad::scale_factor_nonlinearity::KIND,
    &triad::misalignment::MISALIGNMENT,
    &triad::misalignment::CROSS_AXIS_SENSITIVITY,
    &triad::g_sensitivity::KIND,
    &triad::latency::KIND,
    &triad::saturation::KIND,
];

/// The kind of that name among `kinds`.
pub fn find<E: ?Sized>(kinds: &'static [&'static Kind<E>], name: &str) -> Option<&'static Kind<E>> {
    kinds.iter().find(|kind| kind.spec.name == name).copied()
}

/// The names of `kinds`, in order.
pub fn names<E: ?Sized>(kinds: &[&Kind<E>]) -> Vec<&'static str> {
    kinds.iter().map(|kind| kind.spec.name).collect()
}

/// The position of `spec` in the documented order; specs outside the lists (N, B, K) come first.
pub fn rank(spec: &Spec) -> usize {
    CHANNEL.iter().position(|kind| kind.spec.name == spec.name).map_or(0, |place| place + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn the_documentation_has_a_row_for_every_effect_with_all_its_parameters() {
        let page = include_str!("../../../../docs/effects.md");
        let (channel, triad) = page.split_once("## On a triad").unwrap();
        let row = |page: &str, spec: &Spec| {
            let row = page.lines().find(|line| line.starts_with(&format!("| `{}` |", spec.name)));
            let row = row.unwrap_or_else(|| panic!("docs/effects.md has no row for {}", spec.name));
            for name in spec.names() {
                assert!(row.contains(&format!("`{name}`")), "docs/effects.md, {}: `{name}` is missing", spec.name);
            }
        };
        CHANNEL.iter().for_each(|kind| row(channel, kind.spec));
        TRIAD.iter().for_each(|kind| row(triad, kind.spec));
    }

    #[test]
    fn names_differ_and_streams_are_given_once() {
        let channel: BTreeSet<_> = names(&CHANNEL).into_iter().collect();
        assert_eq!(channel.len(), CHANNEL.len());
        assert_eq!(names(&TRIAD).into_iter().collect::<BTreeSet<_>>().len(), TRIAD.len());
        let mut streams: Vec<u16> = CHANNEL.iter().map(|kind| kind.spec.stream).filter(|stream| *stream > 0).collect();
        streams.extend([1, 2, 3]);
        let distinct: BTreeSet<_> = streams.iter().collect();
        assert_eq!(distinct.len(), streams.len());
    }
}
