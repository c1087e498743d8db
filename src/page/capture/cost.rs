//! What the noise that was found costs: the growth of errors without aid under a model of it.

use super::{CaptureView, wide};
use crate::store::SOFTWARE;
use imu_core::units::format_duration;
use imu_cost::{Request, cost};
use imu_diagnosis::model_fit::model_of;
use imu_noise::NoiseReport;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;

/// Times without aid, s. Longer ones than the record would be extrapolations.
const HORIZONS_S: [f64; 4] = [1.0, 10.0, 60.0, 600.0];

/// Writes the table, if the parameters of some gyroscope or accelerometer are usable.
pub(super) fn section(out: &mut String, of: &NoiseReport, view: &CaptureView<'_>) {
    let mut model = model_of(of, &BTreeMap::new(), &view.facts.row.name, SOFTWARE);
    model.channels.retain(|channel, _| of.channels.get(channel).is_some_and(|own| own.usable));
    let request = Request { simulate: false, ..Request::default() };
    let within = |horizon_s: &f64| horizon_s + request.align_s <= of.duration_s;
    let horizons_s: Vec<f64> = HORIZONS_S.into_iter().filter(within).collect();
    if horizons_s.is_empty() {
        return;
    }
    // Without gyroscope and accelerometer there is nothing to integrate.
    let Ok(found) = cost(&model, &model.name, &Request { horizons_s, ..request }) else { return };
    let time = |time_s: f64| format_duration(Duration::from_secs_f64(time_s));
    let _ = write!(
        out,
        "<h2>What this noise costs</h2><p class=\"soft\">The size of an error of unaided integration stays below this in \
         95&nbsp;%: at rest, after {} of alignment, by N, B and K alone. Effects such as a vibration or a warm-up come on top: \
         a diagnosis counts them.</p>{}<table><tr><th scope=\"col\">error</th>",
        time(found.align_s),
        wide("what this noise costs")
    );
    for horizon_s in &found.horizons_s {
        let _ = write!(out, "<th scope=\"col\" class=\"number\">after {}</th>", time(*horizon_s));
    }
    *out += "</tr>";
    for (quantity, growth) in &found.quantities {
        let name = quantity.to_string().replace('_', " ");
        let cells = growth.band95.iter().map(|band| format!("<td class=\"number\">{}</td>", quantity.with_unit(*band)));
        let _ = write!(out, "<tr><th scope=\"row\">{name}</th>{}</tr>", cells.collect::<String>());
    }
    *out += "</table></div>";
}
