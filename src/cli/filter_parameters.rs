//! `vn100d noise --consistent`: N and K with which a filter's covariance is that of the real errors.

use super::args::{ConsistentPair, NoiseArgs, NoiseFormat};
use super::{Context, Outcome, analysis, failed, model, noise, print_json, simulate, table, usage};
use crate::jobs::direct;
use anyhow::Context as _;
use imu_core::sample::{Channel, Triad};
use imu_core::units::format_duration;
use imu_cost::{
    ChannelParameters, CostError, FilterError, FilterParameters, FilterRequest, Pairs, Prediction, RecordFrom,
    filter_parameters,
};
use imu_diagnosis::model_fit::effects_named;
use imu_files::export::{FilterKind, ImuNoise, Target};
use imu_model::simulator::{ChannelModel, SensorModel};
use std::io::Write;
use std::time::Duration;

/// Prints the parameters, or writes a filter's file with one of the pairs.
pub(super) fn run(context: &Context, args: &NoiseArgs, pair: ConsistentPair) -> anyhow::Result<Outcome> {
    let target = match args.format {
        NoiseFormat::For(target) if !context.json => Some((target, kind(target)?)),
        NoiseFormat::Csv if !context.json => {
            return Err(usage("--consistent has no csv: expected table, json or the name of a filter"));
        }
        _ => None,
    };
    let source = source(context, args, target.map(|(target, _)| target))?;
    let allan = source.sensor.channels.keys().map(|channel| (*channel, source.noise.white_and_walk(*channel)));
    let request = FilterRequest {
        over: args.over,
        align_s: args.align.as_secs_f64(),
        record_s: args.record.as_ref().map(Duration::as_secs_f64),
        temperature: args.temperature.as_deref().map(simulate::temperature).transpose()?,
        allan: allan.collect(),
        ..FilterRequest::default()
    };
    let mut found = filter_parameters(&source.sensor, &source.name, &request).map_err(|error| match error {
        FilterError::NoChannel { .. } | FilterError::Cost(CostError::Model(_)) => {
            failed(format!("{}: {error}", source.name))
        }
        _ => usage(error.to_string()),
    })?;
    found.notes.splice(0..0, source.notes);
    let mut stdout = std::io::stdout().lock();
    match (context.json, args.format, target) {
        (true, ..) | (_, NoiseFormat::Json, _) => print_json(&found)?,
        (_, _, Some((target, kind))) => {
            for note in &found.notes {
                eprintln!("note: {note}");
            }
            let pairs = found.channels.iter().map(|(channel, of)| (*channel, chosen(of, kind, pair))).collect();
            write!(stdout, "{}", target.write(&source.noise.consistent(&pairs, reason(&found, kind, pair))))?;
        }
        _ => write_table(&mut stdout, &found)?,
    }
    Ok(if source.rejected { Outcome::WithLoss } else { Outcome::Done })
}

/// The noise that the parameters are for.
struct Source {
    name: String,
    sensor: SensorModel,
    /// What the format has without `--consistent`.
    noise: ImuNoise,
    notes: Vec<String>,
    /// Whether frames or lines of a capture were rejected on the way in.
    rejected: bool,
}

/// Returns the given model, or the one that is fitted to captures with all effects that are found in them.
fn source(context: &Context, args: &NoiseArgs, target: Option<Target>) -> anyhow::Result<Source> {
    if let Some(path) = &args.model {
        let sensor = model::load(path)?;
        let name = path.display().to_string();
        let noise = ImuNoise::of_model(&sensor);
        return Ok(Source { name, sensor, noise, notes: Vec::new(), rejected: false });
    }
    let mut together = analysis::open(context, &args.captures, args.rate)?;
    together.sampled(args.sampling.stated())?;
    let (name, rejected) = (together.name(), together.rejected());
    let report = direct::noise(&together.source, together.plan.clone())?;
    let all = effects_named("all").map_err(usage)?;
    let fit = model::fitted(together, &all, None).with_context(|| format!("the effects in {name} cannot be found"))?;
    // Of the channels that are written; effects may explain what N, B and K alone contradict.
    let plain = report.refusal(|channel| target.map_or(is_integrated(channel), |target| target.holds(channel)));
    let refusal = plain.and(fit.fitted.refusal);
    if let Some(why) = refusal.as_ref().filter(|_| !args.force) {
        return Err(noise::refused("no consistent parameters are written", why));
    }
    let sensor = fit.fitted.model;
    let channels = sensor.channels.iter().filter(|(channel, of)| is_integrated(**channel) && !of.effects.is_empty());
    let effects: Vec<String> = channels.map(|(channel, of)| format!("{} on {channel}", counted(of))).collect();
    let found = if effects.is_empty() { "no further effect".to_owned() } else { effects.join("; ") };
    let mut notes = vec![format!("from the model that was fitted to {name}: N, B, K and {found}")];
    notes.extend(refusal.iter().map(|why| format!("the fitted model may be wrong: {why}")));
    Ok(Source { noise: ImuNoise::of_report(&report, refusal), name, sensor, notes, rejected })
}

/// Returns the names of a channel's effects, with their number if there are several of a kind.
fn counted(of: &ChannelModel) -> String {
    let mut kinds: Vec<(&str, usize)> = Vec::new();
    for effect in &of.effects {
        match kinds.iter_mut().find(|(name, _)| *name == effect.name()) {
            Some((_, count)) => *count += 1,
            None => kinds.push((effect.name(), 1)),
        }
    }
    let one = |(name, count): &(&str, usize)| if *count > 1 { format!("{count} {name}") } else { (*name).to_owned() };
    kinds.iter().map(one).collect::<Vec<_>>().join(", ")
}

/// Returns whether a filter integrates the channel.
fn is_integrated(channel: Channel) -> bool {
    matches!(channel.triad(), Some(Triad::Gyro | Triad::Accel))
}

/// Returns what a target makes of noise, or the refusal of a simulator.
fn kind(target: Target) -> anyhow::Result<FilterKind> {
    target.filter_kind().ok_or_else(|| {
        let filters = Target::ALL.into_iter().filter(|target| target.filter_kind().is_some());
        let names = filters.map(Target::name).collect::<Vec<_>>().join(", ");
        usage(format!(
            "{} is a simulator, which takes the sensor's own noise: --consistent is for table, json, {names}",
            target.name()
        ))
    })
}

fn pairs(of: &ChannelParameters, kind: FilterKind) -> &Pairs {
    match kind {
        FilterKind::WhiteAndWalk => &of.white_and_walk,
        FilterKind::White => &of.white,
    }
}

/// Returns N and K that are written.
fn chosen(of: &ChannelParameters, kind: FilterKind, pair: ConsistentPair) -> [f64; 2] {
    let own = match pair {
        ConsistentPair::Fit => &pairs(of, kind).fit,
        ConsistentPair::Cover => &pairs(of, kind).cover,
    };
    [own.n, own.k.unwrap_or(0.0)]
}

/// Returns the comment of a filter's file: what the numbers are, why they are larger, and the other pair.
fn reason(found: &FilterParameters, kind: FilterKind, pair: ConsistentPair) -> String {
    let [from, to] = found.over_s.map(time);
    let (own, other, name) = match pair {
        ConsistentPair::Fit => {
            ("are closest to the real ones (Kullback-Leibler)", "covers them at every horizon", "--consistent=cover")
        }
        ConsistentPair::Cover => {
            ("are at least the real ones at every horizon", "is closest to them", "--consistent=fit")
        }
    };
    let what = match kind {
        FilterKind::WhiteAndWalk => "N and K",
        FilterKind::White => "White noise (for a filter that estimates no bias)",
    };
    let opposite = if pair == ConsistentPair::Fit { ConsistentPair::Cover } else { ConsistentPair::Fit };
    let numbers = found.channels.iter().map(|(channel, of)| match (kind, chosen(of, kind, opposite)) {
        (FilterKind::WhiteAndWalk, [n, k]) => format!("{channel} {n:.3e}, {k:.3e}"),
        (FilterKind::White, [n, _]) => format!("{channel} {n:.3e}"),
    });
    let numbers = numbers.collect::<Vec<_>>().join("; ");
    let causes = match kind {
        FilterKind::White => String::new(),
        FilterKind::WhiteAndWalk => {
            let of = found.channels.iter().map(|(channel, of)| format!("{channel}: {}", of.summary));
            format!(
                " Closest pair over the Allan values, and what makes that necessary: {}.",
                of.collect::<Vec<_>>().join(". ")
            )
        }
    };
    let extrapolated = if found.extrapolated { ", an extrapolation beyond the record" } else { "" };
    format!(
        "Consistent, at least the sensor's own at rest: {what} with which the predicted errors over {from} to {to} after {} of alignment{extrapolated} \
         {own}.{causes} The pair that {other} ({name}), as densities, before the sensor's own replace smaller ones: {numbers}.",
        time(found.align_s)
    )
}

fn time(time_s: f64) -> String {
    if time_s < 1.0 { format!("{time_s} s") } else { format_duration(Duration::from_secs_f64(time_s)) }
}

fn number(value: f64) -> String {
    if value == 0.0 { "0".to_owned() } else { format!("{value:.2e}") }
}

/// Returns a number with its ratio to the Allan deviation's.
fn inflated(value: f64, ratio: Option<f64>) -> String {
    let ratio = ratio.map(|ratio| if ratio < 9.95 { format!(" (× {ratio:.1})") } else { format!(" (× {ratio:.0})") });
    number(value) + &ratio.unwrap_or_default()
}

/// Returns how much larger the real error is than the predicted one, and at which horizon.
fn worst(of: &Prediction) -> String {
    of.worst_ratio.map_or_else(|| "–".to_owned(), |ratio| format!("{ratio:.2} at {}", time(of.worst_at_s)))
}

fn write_table(to: &mut impl Write, found: &FilterParameters) -> std::io::Result<()> {
    let [from, to_s] = found.over_s.map(time);
    let record = match found.record_from {
        RecordFrom::Request => "given",
        RecordFrom::Model => "that of the model",
        RecordFrom::Assumed => "assumed",
    };
    writeln!(
        to,
        "{}: filter parameters for errors over {from} to {to_s} after {} of alignment, in a record of {} ({record}).",
        found.model,
        time(found.align_s),
        time(found.record_s)
    )?;
    writeln!(
        to,
        "fit: predicted errors are closest to the real ones; cover: they are at least the real ones at every horizon. In brackets: over \
         the Allan value. `off`: the largest ratio of real and predicted standard deviation."
    )?;
    let mut rows = table(&["channel", "unit U", "", "N in U/√Hz", "K in U/√s", "off", "nats"]);
    let nats = |of: &Prediction| of.divergence.map_or_else(|| "–".to_owned(), |nats| format!("{nats:.2}"));
    for (channel, of) in &found.channels {
        let lines = [
            ("Allan", of.allan.as_ref()),
            ("fit", Some(&of.white_and_walk.fit)),
            ("cover", Some(&of.white_and_walk.cover)),
        ];
        let lines = lines.into_iter().filter_map(|(name, of)| Some((name, of?)));
        for (place, (name, own)) in lines.enumerate() {
            let first = if place == 0 { [channel.to_string(), channel.unit().to_owned()] } else { Default::default() };
            let ratios = if name == "Allan" { [None; 2] } else { [own.inflation.n, own.inflation.k] };
            let cells = [
                name.to_owned(),
                inflated(own.n, ratios[0]),
                own.k.map_or_else(String::new, |k| inflated(k, ratios[1])),
                worst(own),
                nats(own),
            ];
            rows.add_row(first.into_iter().chain(cells));
        }
    }
    writeln!(to, "{rows}")?;
    for (channel, of) in &found.channels {
        writeln!(to, "{channel}: {}", of.summary)?;
    }
    writeln!(to, "\nFor filters with a Gauss-Markov process in place of the walk:")?;
    let mut rows = table(&["channel", "unit U", "", "N in U/√Hz", "σ in U", "Tc in s", "off", "nats"]);
    for (channel, of) in &found.channels {
        for (name, own) in [("fit", &of.gauss_markov.fit), ("cover", &of.gauss_markov.cover)] {
            let first =
                if name == "fit" { [channel.to_string(), channel.unit().to_owned()] } else { Default::default() };
            let tc = own.tc_s.map_or_else(|| "–".to_owned(), |tc_s| format!("{tc_s:.3}"));
            let end = if own.tc_at_end == Some(true) { " *" } else { "" };
            let cells = [
                name.to_owned(),
                number(own.n),
                own.sigma.map_or_else(String::new, number),
                tc + end,
                worst(own),
                nats(own),
            ];
            rows.add_row(first.into_iter().chain(cells));
        }
    }
    writeln!(to, "{rows}")?;
    if found
        .channels
        .values()
        .any(|of| [&of.gauss_markov.fit, &of.gauss_markov.cover].iter().any(|of| of.tc_at_end == Some(true)))
    {
        writeln!(to, "*: at the end of what this range tells apart; a long process is a walk of σ√(2/Tc)")?;
    }
    for note in &found.notes {
        writeln!(to, "note: {note}")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simulators_are_refused_with_the_names_of_filters() {
        let refusal = kind(Target::Gazebo).unwrap_err().to_string();
        assert!(refusal.contains("gazebo is a simulator") && refusal.contains("kalibr, openvins"), "{refusal}");
        assert_eq!(kind(Target::RobotLocalization).unwrap(), FilterKind::White);
        assert_eq!(inflated(2e-4, Some(12.3)), "2.00e-4 (× 12)");
        assert_eq!((inflated(0.0, None), time(0.1)), ("0".to_owned(), "0.1 s".to_owned()));
    }
}
