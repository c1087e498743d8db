//! Siblings: what a name states only beside the other names of its table.
//!
//! Indices count from 0 if there is an element 0, and from 1 if there are 1, 2 and 3 without a 0; otherwise they are no axes.
//! `accel` and `mag` of VectorNav's IMU group have the units of its definition if another field of it stands beside them. Pure.

use super::names::clean;
use super::vocabulary::{Meaning, meaning, of_imu_group};
use std::borrow::Cow;
use std::collections::HashSet;

/// Fields by which VectorNav's IMU group is known.
const OF_IMU_GROUP: [&str; 4] = ["angularrate", "uncompaccel", "uncompgyro", "uncompmag"];

/// The names of a table.
pub(super) struct Siblings {
    names: HashSet<String>,
    /// The paths of messages of the IMU group.
    groups: HashSet<String>,
}

impl Siblings {
    pub(super) fn of(names: &[String]) -> Self {
        let names: HashSet<String> = names.iter().map(|name| clean(name).to_owned()).collect();
        let groups = names.iter().filter_map(|name| {
            let (parent, field) = parent(name)?;
            OF_IMU_GROUP.contains(&field).then(|| parent.to_owned())
        });
        Self { groups: groups.collect(), names }
    }

    /// Returns the name with its index counted from 0; with empty brackets if it is no axis.
    pub(super) fn counted<'a>(&self, name: &'a str) -> Cow<'a, str> {
        let Some((before, index)) = index(name) else { return Cow::Borrowed(name) };
        let has = |index: usize| self.names.contains(&format!("{before}[{index}]"));
        match index {
            // A matrix of several quantities.
            _ if has(4) => Cow::Owned(format!("{before}[]")),
            _ if has(0) => Cow::Borrowed(name),
            1.. if has(1) && has(2) && has(3) => Cow::Owned(format!("{before}[{}]", index - 1)),
            _ => Cow::Owned(format!("{before}[]")),
        }
    }

    /// Returns what a name of the table states; `None` if it is of no use.
    pub(super) fn meaning(&self, name: &str) -> Option<Meaning> {
        let in_group = parent(name).is_some_and(|(parent, _)| self.groups.contains(parent));
        in_group.then(|| of_imu_group(name)).flatten().or_else(|| meaning(&self.counted(name)))
    }
}

fn index(name: &str) -> Option<(&str, usize)> {
    let (before, index) = name.strip_suffix(']')?.rsplit_once('[')?;
    Some((before, index.parse().ok()?))
}

/// Returns the path of the message and the field of a path that ends with an axis.
fn parent(name: &str) -> Option<(&str, &str)> {
    let (path, axis) = name.rsplit_once(['.', '/'])?;
    ["x", "y", "z"].contains(&axis).then(|| path.rsplit_once(['.', '/']).unwrap_or(("", path)))
}

#[cfg(test)]
mod tests {
    use super::super::columns::{Column, Columns};
    use super::super::mapping::ColumnMap;
    use std::path::Path;

    /// Returns the channels of a table with the columns that give them.
    fn channels(names: &str) -> Vec<String> {
        let names: Vec<String> = names.split(',').map(str::to_owned).collect();
        let columns =
            Columns::find(&names, false, &ColumnMap::default(), Path::new("table"), &Vec::new).unwrap_or_default();
        let channel = |(column, name): (&Column, &String)| match column {
            Column::Value { channel, .. } => Some(format!("{channel}={name}")),
            _ => None,
        };
        columns.list.iter().zip(&names).filter_map(channel).collect()
    }

    #[test]
    fn indices_are_axes_from_the_first_element_on() {
        let from_0 = ["gyro_x=gyro_rad_s[0]", "gyro_y=gyro_rad_s[1]", "gyro_z=gyro_rad_s[2]"];
        assert_eq!(channels("gyro_rad_s[0],gyro_rad_s[1],gyro_rad_s[2]"), from_0);
        let from_1 = ["gyro_x=gyro_rad_s[1]", "gyro_y=gyro_rad_s[2]", "gyro_z=gyro_rad_s[3]"];
        assert_eq!(channels("gyro_rad_s[1],gyro_rad_s[2],gyro_rad_s[3]"), from_1);
        assert_eq!(channels("temp_celsius,gyro_rad_s[1],gyro_rad_s[2]"), ["temperature=temp_celsius"]);
    }

    #[test]
    fn compensated_values_of_the_imu_group_stand_for_their_triads() {
        let group = |fields: &[&str]| {
            let of_axes = |field: &&str| ["x", "y", "z"].map(|axis| format!("/raw/imu/{field}/{axis}"));
            fields.iter().flat_map(of_axes).collect::<Vec<_>>().join(",")
        };
        let all = channels(&group(&["uncompaccel", "accel", "uncompmag", "mag", "angularrate"]));
        assert_eq!(all.len(), 9, "{all:?}");
        assert!(all.iter().all(|column| !column.contains("uncomp")), "{all:?}");
        // Not one axis of each.
        let partly = channels(&format!("{},/raw/imu/accel/x", group(&["uncompaccel", "angularrate"])));
        assert!(partly.contains(&"accel_x=/raw/imu/accel/x".to_owned()) && partly.len() == 4, "{partly:?}");
        assert_eq!(channels(&group(&["accel"])), Vec::<String>::new());
    }
}
