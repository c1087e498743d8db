//! The names of columns in docs/formats.md (section 4): each states a channel with its unit, or a time. Pure.

use imu_core::sample::{Channel, Triad};
use imu_core::units::{GAUSS_PER_TESLA, RAD_PER_DEG, STANDARD_GRAVITY_M_S2};

/// Names of the columns with stamps, and the decimal places from their unit to a nanosecond.
const STAMPS: [(&str, usize); 4] = [("time_s", 9), ("time_ms", 6), ("time_us", 3), ("time_ns", 0)];
/// Names of the two columns of one stamp: its whole seconds, and the nanoseconds behind them.
const PARTS: [(&str, usize); 2] = [("time_secs", 9), ("time_nsecs", 0)];
/// The unit of values that no factor makes SI: steps of a converter, about an offset of its own.
pub const COUNTS: &str = "counts";

/// The meaning of a name of docs/formats.md.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Target {
    Stamp { places: usize },
    Part { places: usize },
    Value { channel: Channel, unit: &'static str, factor: f64 },
}

/// Returns the unit suffixes that a channel's column may have, with the unit's name and the factor to the channel's
/// unit.
pub(super) fn suffixes(channel: Channel) -> &'static [(&'static str, &'static str, f64)] {
    match channel.triad() {
        Some(Triad::Attitude) => &[("_deg", "deg", 1.0), ("_rad", "rad", 1.0 / RAD_PER_DEG)],
        Some(Triad::Mag) => &[
            ("_gauss", "gauss", 1.0),
            ("_tesla", "T", GAUSS_PER_TESLA),
            ("_ut", "µT", 1e-6 * GAUSS_PER_TESLA),
            ("_nt", "nT", 1e-9 * GAUSS_PER_TESLA),
            ("_mt", "mT", 1e-3 * GAUSS_PER_TESLA),
            ("_mgauss", "mgauss", 1e-3),
            ("_counts", COUNTS, 1.0),
        ],
        Some(Triad::Accel) => &[
            ("_m_s2", "m/s²", 1.0),
            ("_g", "g", STANDARD_GRAVITY_M_S2),
            ("_mg", "mg", 1e-3 * STANDARD_GRAVITY_M_S2),
            ("_ug", "µg", 1e-6 * STANDARD_GRAVITY_M_S2),
            ("_counts", COUNTS, 1.0),
        ],
        Some(Triad::Gyro) => &[
            ("_rad_s", "rad/s", 1.0),
            ("_deg_s", "deg/s", RAD_PER_DEG),
            ("_dps", "deg/s", RAD_PER_DEG),
            ("_mdps", "mdps", 1e-3 * RAD_PER_DEG),
            ("_mrad_s", "mrad/s", 1e-3),
            ("_deg_h", "deg/h", RAD_PER_DEG / 3600.0),
            ("_counts", COUNTS, 1.0),
        ],
        None if channel == Channel::Temperature => &[("_c", "°C", 1.0)],
        None => &[("_kpa", "kPa", 1.0), ("_hpa", "hPa", 0.1), ("_pa", "Pa", 1e-3), ("_bar", "bar", 100.0)],
    }
}

/// Returns the channel and unit that a column's name denotes.
pub(super) fn known_column(name: &str) -> Option<(Channel, &'static str, f64)> {
    Channel::ALL.into_iter().find_map(|channel| {
        let suffix = name.strip_prefix(channel.name())?;
        let (_, unit, factor) = suffixes(channel).iter().find(|(known, ..)| *known == suffix)?;
        Some((channel, *unit, *factor))
    })
}

fn value_of(name: &str) -> Option<Target> {
    known_column(name).map(|(channel, unit, factor)| Target::Value { channel, unit, factor })
}

/// Returns the meaning of a name that the user may give to a foreign column.
pub(super) fn target(name: &str) -> Option<Target> {
    let of = |known: &[(&str, usize)]| known.iter().find(|(known, _)| *known == name).map(|(_, places)| *places);
    let stamp = of(&STAMPS).map(|places| Target::Stamp { places });
    stamp.or_else(|| of(&PARTS).map(|places| Target::Part { places })).or_else(|| value_of(name))
}

/// Returns the names that [`target`] accepts, abbreviated.
pub(super) fn allowed_names() -> &'static str {
    "time_{s,ms,us,ns}, time_{secs,nsecs}, {yaw,pitch,roll}_{deg,rad}, mag_{x,y,z}_{gauss,mgauss,tesla,mt,ut,nt,counts}, \
     accel_{x,y,z}_{m_s2,g,mg,ug,counts}, gyro_{x,y,z}_{rad_s,mrad_s,deg_s,dps,mdps,deg_h,counts}, temperature_c and \
     pressure_{kpa,hpa,pa,bar}"
}

/// Returns a column's name without the space, quotes and byte-order mark that some programs put around it.
pub(super) fn clean(name: &str) -> &str {
    name.trim_matches(|c: char| c.is_whitespace() || c == '\u{FEFF}' || c == '"')
}
