//! `vn100d noise`: noise parameters.

use super::analysis;
use super::args::{NoiseArgs, NoiseFormat, SheetChoice, Undecided};
use super::figures::{counted, hertz, rounded, with_interval};
use super::output::Output;
use super::within::Limits;
use super::{Context, Outcome, failed, junit, limits, table};
use crate::jobs::direct;
use anyhow::Context as _;
use imu_files::export::paste::{NoiseDocument, Paste};
use imu_model::simulator::SensorModel;
use imu_noise::datasheet::{Comparison, Datasheet, Verdict, compare_report};
use imu_noise::fit::{Estimate, Flag, NoiseReport};
use imu_noise::words::grouped;
use serde_json::Value;
use std::io::Write as _;
use std::path::Path;

/// Prints the parameters.
pub(super) fn run(context: &Context, args: &NoiseArgs) -> anyhow::Result<Outcome> {
    let sheet = args.datasheet.as_ref().map(datasheet).transpose()?;
    let limits = args.within.as_deref().map(Limits::open).transpose()?;
    let read: Vec<&Path> = args.captures.iter().map(Path::new).chain(args.within.as_deref()).collect();
    let junit = args.junit.as_deref().map(|path| Output::create(path, args.force, &read)).transpose()?;
    let mut together = analysis::open(context, &args.captures, args.rate)?;
    together.sampled(args.sampling.stated())?;
    let (rejected, windows) = (together.rejected(), together.windows());
    let mut report = direct::noise(&together.source, together.plan)?;
    let comparison = sheet.map(|sheet| compare_report(&sheet, &report, windows)).transpose()?;
    report.datasheet = comparison.as_ref().map(serde_json::to_value).transpose()?;
    let target = if let NoiseFormat::For(target) = args.format { Some(target).filter(|_| !context.json) } else { None };
    let refusal = target.filter(|_| !args.force).and_then(|target| Some((target, target.refusal(&report)?)));
    if let Some((target, why)) = refusal {
        return Err(refused(&format!("{} is not written", target.name()), &why));
    }
    let judged = limits.map_or_else(Vec::new, |limits| limits.judge(&report));
    let lenient = args.undecided == Undecided::Reported;
    if let Some(output) = junit {
        let (captures, summary) = (args.captures.join(" "), headline(&report));
        let inputs = [("captures", captures.as_str())];
        let about = junit::About { command: "noise", inputs: &inputs, summary: &summary, lenient };
        output.put(junit::report(&about, &judged).as_bytes())?;
    }
    match (context.json, args.format, target) {
        (true, ..) | (_, NoiseFormat::Json, _) => {
            limits::print_json(&NoiseDocument::from(report), &judged)?;
        }
        (_, _, Some(target)) => write!(std::io::stdout().lock(), "{}", target.write_report(&report))?,
        (_, NoiseFormat::Csv, _) => write_csv(std::io::stdout().lock(), &report)?,
        _ => {
            let mut stdout = std::io::stdout().lock();
            write_table(&mut stdout, &report, args.verbose)?;
            write_paste(&mut stdout, &Paste::of(&report), &args.captures.join(" "))?;
            if let Some(comparison) = comparison {
                write_comparison(&mut stdout, &comparison)?;
            }
            limits::write(&mut stdout, &judged)?;
        }
    }
    if context.json || args.format != NoiseFormat::Table {
        limits::complain(&judged)?;
    }
    Ok(limits::outcome(&judged, rejected, lenient))
}

/// Returns the chosen datasheet.
fn datasheet(choice: &SheetChoice) -> anyhow::Result<Datasheet> {
    let path = match choice {
        SheetChoice::Named(sheet) => return Ok(sheet.as_ref().clone()),
        SheetChoice::File(path) => path,
    };
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path).with_context(|| format!("the datasheet {name} cannot be read"))?;
    Ok(Datasheet::from_toml(&text, &name)?)
}

/// Returns the error that parameters contradict the record, with the option that overrides it.
pub(super) fn refused(what: &str, why: &str) -> anyhow::Error {
    let message = format!("{what}, since it would be wrong: {why}; --force writes it with a comment");
    failed(message)
}

/// Marks a number that the curve alone supports.
const CURVE: &str = " *";
/// Marks a channel that is not usable.
const UNUSABLE: &str = " !";

/// Returns a value with its interval, or the limit below which it lies.
fn cell(estimate: &Estimate) -> String {
    let mark = if estimate.source.is_some() { CURVE } else { "" };
    match (estimate.value, estimate.ci95, estimate.upper_limit95) {
        (Some(value), Some(ends), _) => with_interval(value, ends) + mark,
        (_, _, Some(limit)) => format!("< {}{mark}", rounded(limit, 3)),
        _ => "–".to_owned(),
    }
}

fn number(value: f64) -> String {
    rounded(value, 4)
}

/// Returns what was analysed, as a sentence.
fn headline(report: &NoiseReport) -> String {
    format!(
        "{}: {:.1} s at {}, {}, {} missing.",
        report.capture,
        report.duration_s,
        hertz(report.rate_hz),
        counted(report.samples, "sample", "samples"),
        report.missing
    )
}

fn write_table(mut to: impl std::io::Write, report: &NoiseReport, verbose: bool) -> std::io::Result<()> {
    writeln!(to, "{} Values with 95 % intervals; `<`: not identified, 95 % upper limit.", headline(report))?;
    write!(to, "{}", super::stillness(report.at_rest_s, report.moving_s))?;
    let mut rows = table(&["channel", "unit U", "N in U/√Hz", "B in U", "K in U/√s", "Q in U·s", "R in U/s", "fit p"]);
    for (channel, found) in &report.channels {
        rows.add_row([
            format!("{channel}{}", if found.usable { "" } else { UNUSABLE }),
            found.unit.clone(),
            cell(&found.n),
            cell(&found.b),
            cell(&found.k),
            cell(&found.q),
            cell(&found.r),
            found.fit.p_value.map_or_else(|| "–".to_owned(), |p| format!("{p:.2}")),
        ]);
        if let Some(process) = &found.gauss_markov {
            rows.add_row([
                channel.name().to_owned(),
                format!("{}, s", found.unit),
                "Gauss–Markov process".to_owned(),
                format!("σ {}", cell(&process.sigma)),
                format!("Tc {}", cell(&process.tc_s)),
                String::new(),
                String::new(),
                String::new(),
            ]);
        }
    }
    let rows = rows.to_string();
    writeln!(to, "{rows}")?;
    for (mark, meaning) in [
        (UNUSABLE, "the channel is not usable; its reason stands below"),
        (CURVE, "from the Allan deviation alone, which the fit contradicts"),
    ] {
        if rows.contains(&format!("{mark} ")) {
            writeln!(to, "`{}`: {meaning}.", mark.trim())?;
        }
    }
    for (channel, found) in &report.channels {
        if let Some(reason) = found.reason.as_ref().filter(|_| !found.usable) {
            writeln!(to, "{channel}: NOT USABLE: {reason}")?;
        }
        for sentence in found.sentences(number) {
            writeln!(to, "{channel}: {sentence}")?;
        }
        write_flags(&mut to, channel.name(), &found.flags, verbose)?;
        for of in &report.captures {
            let flags = of.flags.get(channel).map(Vec::as_slice).unwrap_or_default();
            write_flags(&mut to, &format!("{channel} in {}", of.capture), flags, verbose)?;
        }
        let with = report.disturbances.get(channel).and_then(|about| about.with_disturbances.as_ref());
        if let Some(with) = with {
            writeln!(to, "{channel}: with all of that N {}, B {}, K {}", cell(&with.n), cell(&with.b), cell(&with.k))?;
        }
    }
    Ok(())
}

/// Writes what disturbed a channel: the number of each kind of which there may be many, and sentences for the others.
fn write_flags(to: &mut impl std::io::Write, whose: &str, flags: &[Flag], verbose: bool) -> std::io::Result<()> {
    let (words, counted, others) = grouped(flags);
    if let Some(words) = words {
        writeln!(to, "{whose}: {words}{}", if verbose { "" } else { " (--verbose lists them)" })?;
    }
    let listed = counted.into_iter().filter(|_| verbose).chain(others);
    listed.into_iter().try_for_each(|flag| writeln!(to, "{whose}: {}", flag.words()))
}

/// Writes which number to paste where.
fn write_paste(mut to: impl std::io::Write, paste: &Paste, captures: &str) -> std::io::Result<()> {
    let (header, rows) = paste.table(number);
    if rows.is_empty() {
        return Ok(());
    }
    writeln!(
        to,
        "\nWhich number to paste where, each in that program's own convention. One number stands for three axes, that of the largest; \
         `each axis`: the file has all three, and the largest stands here. `<`: not identified, 95 % upper limit. `–`: the program takes \
         none, or the record has none for it."
    )?;
    let mut shown = table(&header);
    let refused = rows.iter().flatten().any(|cell| cell == Paste::UNUSABLE);
    shown.add_rows(rows);
    writeln!(to, "{shown}")?;
    if refused {
        writeln!(
            to,
            "`{}`: a channel may not be used, for the reason above. Its files are refused; --force writes them with a comment.",
            Paste::UNUSABLE
        )?;
    }
    writeln!(
        to,
        "`vn100d noise {captures} --format NAME` writes the file for the program of that name.\n{}",
        paste.note
    )
}

/// Writes the datasheet's figures beside the capture's.
fn write_comparison(mut to: impl std::io::Write, comparison: &Comparison) -> std::io::Result<()> {
    let sampling = &comparison.sampling;
    writeln!(
        to,
        "\nBeside {} ({}). {} Hz of {} Hz, filter windows accel {}, gyro {}, mag {}{}. `predicted`: the datasheet's density after \
         filter window and output rate, read as a two-sided density; `one-sided`: read as a one-sided one, whose N is smaller \
         by √2. The verdict goes by the first. Bias stability is the lowest Allan deviation.",
        comparison.name,
        comparison.source,
        sampling.rate_hz,
        sampling.internal_rate_hz,
        sampling.filter_window.accel,
        sampling.filter_window.gyro,
        sampling.filter_window.mag,
        if sampling.assumed { " (the factory's, since the capture does not have them)" } else { "" }
    )?;
    let mut rows =
        table(&["channel", "density", "datasheet", "predicted", "verdict", "Allan minimum", "datasheet", "verdict"]);
    let dash = || "–".to_owned();
    for (channel, found) in &comparison.channels {
        let (density, bias) = (found.noise_density.as_ref(), found.bias_stability.as_ref());
        rows.add_row([
            channel.name().to_owned(),
            density.map_or_else(dash, |of| format!("{:.3e} {}", of.measured, of.unit)),
            density.map_or_else(dash, |of| format!("{:.3e} ({})", of.datasheet, of.printed)),
            density.map_or_else(dash, |of| {
                format!("{:.3e} ({:.2} ×); one-sided {:.3e}", of.predicted, of.sampling_factor, of.predicted_one_sided)
            }),
            density.map_or_else(dash, |of| of.verdict.words().to_owned()),
            bias.map_or_else(dash, |of| format!("{:.3e} {} at {:.0} s", of.allan_minimum, of.unit, of.tau_s)),
            bias.map_or_else(dash, |of| format!("{:.3e} ({})", of.datasheet, of.printed)),
            match bias {
                Some(of) => of.needed_s.map_or_else(
                    || of.verdict.words().to_owned(),
                    |needed_s| {
                        format!("{}: {:.0} min of recording at rest would do", of.verdict.words(), needed_s / 60.0)
                    },
                ),
                None if found.verdict == Verdict::NotAtRest => found.verdict.words().to_owned(),
                None => dash(),
            },
        ]);
    }
    writeln!(to, "{rows}")
}

fn write_csv(to: impl std::io::Write, report: &NoiseReport) -> anyhow::Result<()> {
    let mut writer = csv::Writer::from_writer(to);
    writer.write_record([
        "channel",
        "parameter",
        "unit",
        "value",
        "ci95_low",
        "ci95_high",
        "upper_limit95",
        "identified",
        "source",
        "usable",
        "reason",
    ])?;
    let text = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
    for (channel, found) in &report.channels {
        let terms = [("N", &found.n), ("B", &found.b), ("K", &found.k), ("Q", &found.q), ("R", &found.r)];
        let process = found.gauss_markov.iter();
        let process = process.flat_map(|of| [("gauss_markov.sigma", &of.sigma), ("gauss_markov.tc_s", &of.tc_s)]);
        for (letter, estimate) in terms.into_iter().chain(process) {
            writer.write_record([
                channel.name().to_owned(),
                letter.to_owned(),
                estimate.unit.clone(),
                text(estimate.value),
                text(estimate.ci95.map(|[low, _]| low)),
                text(estimate.ci95.map(|[_, high]| high)),
                text(estimate.upper_limit95),
                estimate.identified.to_string(),
                estimate.source.clone().unwrap_or_default(),
                found.usable.to_string(),
                found.reason.clone().unwrap_or_default(),
            ])?;
        }
    }
    writer.flush()?;
    Ok(())
}

/// Returns the found values beside those of the emulated sensor's model.
pub(super) fn comparison(noise: &Value, model: &SensorModel) -> String {
    let mut rows = table(&["channel", "N model", "N found", "B model", "B found [95 %]", "K model", "K found [95 %]"]);
    for (channel, truth) in &model.channels {
        let Some(found) = noise["channels"].get(channel.name()) else { continue };
        let estimate = |letter: &str| -> String {
            serde_json::from_value::<Estimate>(found[letter].clone())
                .map_or_else(|_| "–".to_owned(), |found| cell(&found))
        };
        let n = found["N"]["value"].as_f64();
        rows.add_row([
            format!("{channel} {}", channel.unit()),
            format!("{:.3e}", truth.n),
            n.map_or_else(|| "–".to_owned(), |n| format!("{n:.3e} ({:+.2} %)", 100.0 * (n / truth.n - 1.0))),
            format!("{:.3e}", truth.b),
            estimate("B"),
            format!("{:.3e}", truth.k),
            estimate("K"),
        ]);
    }
    rows.to_string()
}

#[cfg(test)]
mod tests {
    use super::super::analysis::Together;
    use super::*;
    use imu_core::sample::{Channel, StatedSampling};
    use imu_noise::fit::GaussMarkov;

    const FAR: f64 = 1e9;

    /// Returns white noise of 4000 samples at 40 Hz, changed by `change`, as a recording.
    fn recording(directory: &std::path::Path, change: impl Fn(usize, f64) -> f64) -> String {
        use std::fmt::Write as _;
        let mut state = 1u64;
        let mut text = "time_s,gyro_x_rad_s\n".to_owned();
        for i in 0..4000 {
            state = 16_807 * state % 2_147_483_647;
            let value = 0.002 * (state as f64 / 2_147_483_647.0 - 0.5);
            writeln!(text, "{:.3},{:.6}", i as f64 * 0.025, change(i, value)).unwrap();
        }
        let path = directory.join("white.csv");
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    }

    fn opened(path: String) -> Together {
        let context = Context { data_dir: None, config: None, json: false, ..Context::default() };
        analysis::open(&context, &[path], None).unwrap()
    }

    fn report(together: Together) -> NoiseReport {
        direct::noise(&together.source, together.plan).unwrap()
    }

    /// Flags of the job's document (`Flag::out_of_range`, `Flag::other_rate`) appear here as well.
    #[test]
    fn what_was_left_out_is_flagged_as_in_the_jobs_document() {
        let directory = tempfile::tempdir().unwrap();
        let mut together = opened(recording(directory.path(), |i, value| if i == 1000 { FAR } else { value }));
        together.plan.other_rate = 700;
        let found = report(together);
        let flags = &found.channels[&Channel::GyroX].flags;
        for expected in [Flag::out_of_range(Channel::GyroX, 1), Flag::other_rate(40.0, 700)] {
            assert!(flags.contains(expected.as_ref().unwrap()), "{expected:?} in {flags:?}");
        }
        let quiet = opened(recording(directory.path(), |_, value| value));
        assert!(report(quiet).channels[&Channel::GyroX].flags.iter().all(|flag| flag.kind != "other_rate"));
    }

    /// A turn of 20 s at 10 °/s does not change the parameters; a record that never rests has none.
    #[test]
    fn what_moved_is_left_out_and_what_never_rested_is_reported() {
        let directory = tempfile::tempdir().unwrap();
        let turned = |i: usize| if (1200..2000).contains(&i) { 0.17 + 0.05 * (i as f64 * 0.1).sin() } else { 0.0 };
        let found = report(opened(recording(directory.path(), |i, value| value + turned(i))));
        let still = report(opened(recording(directory.path(), |_, value| value)));
        assert_eq!((still.at_rest_s, still.moving_s), (Some(100.0), Some(0.0)));
        let (at_rest_s, moving_s) = (found.at_rest_s.unwrap(), found.moving_s.unwrap());
        assert!((20.0..24.0).contains(&moving_s) && (at_rest_s + moving_s - 100.0).abs() < 1e-9, "{moving_s}");
        let of = |report: &NoiseReport| report.channels[&Channel::GyroX].clone();
        let ratio = of(&found).n.value.unwrap() / of(&still).n.value.unwrap();
        assert!((0.93..1.07).contains(&ratio), "{ratio}");
        let count = |report: &NoiseReport, kind: &str| of(report).flags.iter().filter(|flag| flag.kind == kind).count();
        assert_eq!((count(&found, "in_motion"), count(&still, "in_motion")), (1, 0));

        let driven = |i: usize| 0.3 + 0.2 * (i as f64 * 0.05).sin() + 0.1 * (i as f64 * 0.013).cos();
        let path = recording(directory.path(), |i, value| value + driven(i));
        let found = report(opened(path.clone()));
        assert_eq!((found.at_rest_s, found.moving_s, count(&found, "not_at_rest")), (Some(0.0), Some(100.0), 1));
        let channel = of(&found);
        assert!(channel.n.value.is_none() && channel.n.upper_limit95.is_none(), "{channel:?}");
        let compared = compare_report(&imu_noise::datasheet::vn_100(), &found, None).unwrap();
        assert_eq!(compared.channels[&Channel::GyroX].verdict, Verdict::NotAtRest);
        let together = opened(path);
        let allan = direct::allan(&together.source, together.plan, &crate::jobs::JobParameters::default()).unwrap();
        assert_eq!((allan.at_rest_s, allan.moving_s), (Some(0.0), Some(100.0)));
        assert!(
            allan.channels[&Channel::GyroX].tau_s.is_empty() && allan.warnings[0].contains("not at rest"),
            "{allan:?}"
        );
    }

    /// The known motion in real recordings is found through the whole way from the file.
    #[test]
    fn real_recordings_are_divided_as_they_were_made() {
        for (file, moving) in [
            ("vn100-car/data_circle2_0.db3", 1.0..=1.0),
            ("vn100-cart/circle_carter.imu.raw.txt.gz", 1.0..=1.0),
            ("vn100-desk/live_capture.txt.gz", 0.0..=0.0),
            ("mpu6050/still-10min.csv.gz", 0.0..=0.0),
            ("repoimu/TStick_Test01_Static.csv.gz", 0.0..=0.0),
            ("broad/26_disturbed_phone_vibration_A.csv.gz", 0.5..=0.7),
        ] {
            let Some(path) = vn100_testkit::real_data(file) else { return };
            let found = report(opened(path.to_str().unwrap().to_owned()));
            let (at_rest_s, moving_s) = (found.at_rest_s.unwrap(), found.moving_s.unwrap());
            let share = moving_s / (at_rest_s + moving_s);
            assert!(moving.contains(&share), "{file}: {at_rest_s} s at rest, {moving_s} s in motion");
            let gyro = &found.channels[&Channel::GyroZ];
            let flagged = gyro.flags.iter().any(|flag| flag.kind == "not_at_rest");
            assert_eq!((flagged, gyro.n.value.is_none()), (share == 1.0, share == 1.0), "{file}");
        }
    }

    #[test]
    fn a_gauss_markov_process_is_shown_in_table_and_csv() {
        let directory = tempfile::tempdir().unwrap();
        let mut report = report(opened(recording(directory.path(), |_, value| value)));
        let text = |report: &NoiseReport| {
            let (mut table, mut csv) = (Vec::new(), Vec::new());
            write_table(&mut table, report, true).unwrap();
            write_csv(&mut csv, report).unwrap();
            [table, csv].map(|bytes| String::from_utf8(bytes).unwrap())
        };
        let [table, csv] = text(&report);
        assert!(!table.contains("Gauss") && !csv.contains("gauss"), "{table}{csv}");
        report.channels.get_mut(&Channel::GyroX).unwrap().gauss_markov = Some(GaussMarkov {
            sigma: Estimate::of("rad/s", 2e-3, [1.5e-3, 2.5e-3]),
            tc_s: Estimate::of("s", 60.0, [50.0, 80.0]),
        });
        let [table, csv] = text(&report);
        assert!(table.contains("σ 2.00e-3 [1.50e-3, 2.50e-3]") && table.contains("Tc 60.0 [50.0, 80.0]"), "{table}");
        assert!(csv.contains("gyro_x,gauss_markov.sigma,rad/s,0.002,0.0015,0.0025,,true,,true,\n"), "{csv}");
        assert!(csv.contains("gyro_x,gauss_markov.tc_s,s,60,50,80,,true,,true,\n"), "{csv}");
    }

    /// The usual questions about a record: B beside the lowest deviation, how long to record, why the curve does not
    /// rise.
    #[test]
    fn the_table_shows_how_long_to_record_and_why_no_walk_is_seen() {
        let directory = tempfile::tempdir().unwrap();
        let mut report = report(opened(recording(directory.path(), |_, value| value)));
        let rendered = |report: &NoiseReport| {
            let mut table = Vec::new();
            write_table(&mut table, report, true).unwrap();
            String::from_utf8(table).unwrap()
        };
        let white = rendered(&report);
        for part in [
            "gyro_x: lowest Allan deviation ",
            "and B is at most this, to within the scatter of the curve",
            "gyro_x: no flicker is seen",
            "gyro_x: no random walk is seen, hence no slope of +½: one as large as its limit, ",
            "this record's curve",
        ] {
            assert!(white.contains(part), "{part} is not in\n{white}");
        }
        let gyro = report.channels.get_mut(&Channel::GyroX).unwrap();
        gyro.b = Estimate::of("rad/s", 2e-5, [1e-5, 3e-5]);
        gyro.record_needed.b = Some(2400.0);
        gyro.walk_shows_beyond_s = Some(1e5);
        let flicker = rendered(&report);
        assert!(
            flicker.contains("gyro_x: to know a value to ±20 %, record at rest and without a gap: 40 min for B\n"),
            "{flicker}"
        );
        assert!(
            flicker.contains(" beyond 27.8 h; this record's curve ends at ") && !flicker.contains("no flicker"),
            "{flicker}"
        );
    }

    /// An unusable channel is marked in table and CSV, and none of its numbers is offered to a program.
    #[test]
    fn what_is_not_usable_is_marked_and_goes_to_no_program() {
        let directory = tempfile::tempdir().unwrap();
        let mut report = report(opened(recording(directory.path(), |_, value| value)));
        let rendered = |report: &NoiseReport| {
            let (mut text, mut csv) = (Vec::new(), Vec::new());
            write_table(&mut text, report, true).unwrap();
            write_paste(&mut text, &Paste::of(report), "white.csv").unwrap();
            write_csv(&mut csv, report).unwrap();
            [text, csv].map(|bytes| String::from_utf8(bytes).unwrap())
        };
        let [text, csv] = rendered(&report);
        for part in ["vn100d noise white.csv --format NAME", "│ kalibr ", "e-5 rad/s/√Hz ", "often ten times as large"]
        {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        assert!(!text.contains("accelerometer") && !text.contains("`!`") && !text.contains("`*`"), "{text}");
        assert!(csv.starts_with(
            "channel,parameter,unit,value,ci95_low,ci95_high,upper_limit95,identified,source,usable,reason\n"
        ));
        let gyro = report.channels.get_mut(&Channel::GyroX).unwrap();
        gyro.refuse("it predicts another deviation".to_owned());
        gyro.n.source = Some("allan deviation".to_owned());
        let [text, csv] = rendered(&report);
        for part in [
            "│ gyro_x ! ",
            "] * ",
            "`!`: the channel is not usable; its reason stands below.\n",
            "`*`: from the Allan deviation alone, which the fit contradicts.\n",
            "gyro_x: NOT USABLE: it predicts another deviation\n",
            " not usable ",
            "--force writes them with a comment",
        ] {
            assert!(text.contains(part), "{part} is not in\n{text}");
        }
        assert!(!text.contains("e-5 rad/s/√Hz ") && !text.contains("no flicker is seen"), "{text}");
        assert!(csv.contains(",true,allan deviation,false,it predicts another deviation\n"), "{csv}");
    }

    /// A user's own datasheet, and a file that is none.
    #[test]
    fn a_datasheet_is_read_from_a_file_and_refused_with_its_name() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("own.toml");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            datasheet(&SheetChoice::File(path.clone()))
        };
        let sheet =
            read("name = 'own'\n[gyro]\nnoise_density_rad_s_sqrt_hz = 2e-4\nbias_stability_rad_s = 1e-3").unwrap();
        let compared = compare_report(&sheet, &report(opened(recording(directory.path(), |_, value| value))), None);
        let compared = compared.unwrap();
        let found = &compared.channels[&Channel::GyroX];
        assert_eq!((compared.name.as_str(), found.verdict), ("own", Verdict::Within), "{found:?}");
        let error = read("name = 'own'\n[gyroscope]").unwrap_err().to_string();
        assert!(error.contains("own.toml") && error.contains("gyroscope") && error.contains("`accel`"), "{error}");
    }

    /// Returns a sensor that sends means of four at its internal rate (finding A1).
    fn means_of_four(directory: &std::path::Path) -> String {
        use rand::SeedableRng as _;
        use rand_distr::{Distribution as _, StandardNormal};
        use std::fmt::Write as _;
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(23);
        let white: Vec<f64> = (0..40_003).map(|_| StandardNormal.sample(&mut rng)).collect();
        let mut text = "time_s,gyro_x_rad_s\n".to_owned();
        for (i, four) in white.windows(4).enumerate() {
            writeln!(text, "{:.5},{:.9}", i as f64 / 800.0, 1e-3 * four.iter().sum::<f64>() / 4.0).unwrap();
        }
        let path = directory.join("means.csv");
        std::fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    }

    #[test]
    fn a_filter_that_is_stated_or_found_leaves_the_density_as_it_is() {
        let directory = tempfile::tempdir().unwrap();
        let path = means_of_four(directory.path());
        let density = 1e-3 / 800f64.sqrt();
        let mut stated = opened(path.clone());
        stated.sampled(Some(StatedSampling { filter_window: 4, internal_rate_hz: None })).unwrap();
        for (together, source, internal) in [(stated, "option", true), (opened(path), "fitted", false)] {
            let report = report(together);
            let found = &report.channels[&Channel::GyroX];
            let [low, high] = found.n.ci95.unwrap();
            assert!(found.usable && low < density && density < high, "{found:?}");
            assert!((high - low) / density < 0.1, "{found:?}");
            let bandwidth = found.bandwidth.as_ref().unwrap();
            let actual = (bandwidth.kind.as_str(), bandwidth.value, bandwidth.source.as_str());
            assert_eq!(actual, ("moving_average", Some(4.0), source), "{found:?}");
            assert_eq!(found.n.internal.is_some(), internal);
            assert!(
                found.k.value.is_none() && found.k.upper_limit95.is_some_and(|limit| limit < 1e-3),
                "{:?}",
                found.k
            );
            let mut table = Vec::new();
            write_table(&mut table, &report, true).unwrap();
            let table = String::from_utf8(table).unwrap();
            assert!(table.contains("gyro_x: behind a moving average of 4"), "{table}");
        }
    }
}
