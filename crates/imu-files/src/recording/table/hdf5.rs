//! HDF5, and MATLAB's `.mat` of version 7.3, which is HDF5: the data sets of numbers in all groups. Pure.
//!
//! A data set is named by its path (`imu0/gyro_rad_s`). Read by the crate `hdf5-pure`, without C; groups are followed to a
//! depth of eight.

use super::arrays::{Array, Arrays, Budget, Data};
use hdf5_pure::{DType, Dataset, File, Group};

const DEPTH_MAX: usize = 8;
/// Data sets that are looked at, and groups: links may lead back to a group above.
const SETS_MAX: usize = 1024;
const GROUPS_MAX: usize = 1024;

/// Reads the data sets of a file.
///
/// # Errors
/// What was found and what would be right.
pub(super) fn read(bytes: Vec<u8>) -> Result<Arrays, String> {
    let damaged = |error: hdf5_pure::Error| format!("its HDF5 is damaged or was cut: {error}");
    let budget = Budget::of(bytes.len());
    let file = File::from_bytes(bytes).map_err(damaged)?;
    let mut found = Found { arrays: Vec::new(), left_out: Vec::new(), groups: 0, beyond: 0, budget };
    found.group(&file.root(), "", 0)?;
    if found.beyond > 0 {
        found.left_out.push(format!("{} data sets beyond the first {SETS_MAX}", found.beyond));
    }
    if found.arrays.is_empty() {
        Err("it has no data set of numbers".to_owned())
    } else {
        Arrays::of(found.arrays, found.left_out)
    }
}

/// What is found in a file.
struct Found {
    arrays: Vec<Array>,
    left_out: Vec<String>,
    groups: usize,
    /// Data sets that were not looked at.
    beyond: usize,
    budget: Budget,
}

impl Found {
    /// Reads the data sets of a group.
    fn group(&mut self, group: &Group, path: &str, depth: usize) -> Result<(), String> {
        let damaged = |error: hdf5_pure::Error| format!("its group {path:?} is damaged or was cut: {error}");
        let called = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") };
        self.groups += 1;
        if self.groups > GROUPS_MAX {
            return Err(format!("it has more than {GROUPS_MAX} groups, or one that leads back to itself"));
        }
        for name in group.datasets().map_err(damaged)? {
            let called = called(&name);
            if self.arrays.len() + self.left_out.len() >= SETS_MAX {
                self.beyond += 1;
            } else {
                self.set(&group.dataset(&name).map_err(damaged)?, called)?;
            }
        }
        for name in group.groups().map_err(damaged)? {
            // MATLAB keeps what its cells refer to there.
            if name == "#refs#" {
                continue;
            }
            if depth < DEPTH_MAX {
                self.group(&group.group(&name).map_err(damaged)?, &called(&name), depth + 1)?;
            } else {
                self.left_out.push(called(&name));
            }
        }
        Ok(())
    }

    /// Reads a data set, unless it has no numbers.
    fn set(&mut self, set: &Dataset, name: String) -> Result<(), String> {
        let damaged = |error: hdf5_pure::Error| format!("its data set {name:?} is damaged or was cut: {error}");
        let product = |sides: &[u64]| {
            let sides = sides.iter().map(|side| usize::try_from(*side).unwrap_or(usize::MAX));
            sides.fold(1_usize, usize::saturating_mul)
        };
        let sides = set.shape().map_err(damaged)?;
        let kind = set.dtype().map_err(damaged)?;
        let is_float = matches!(kind, DType::F32 | DType::F64);
        let is_whole = matches!(
            kind,
            DType::I8 | DType::I16 | DType::I32 | DType::I64 | DType::U8 | DType::U16 | DType::U32 | DType::U64
        );
        if !is_float && !is_whole {
            self.left_out.push(name);
            return Ok(());
        }
        self.budget.take_numbers(product(&sides))?;
        // A chunk is decompressed whole, however little of it the set has.
        let chunk = set.chunk_shape().map_err(damaged)?.map_or(0, |sides| product(&sides));
        if chunk.saturating_mul(size_of::<f64>()) > self.budget.left() {
            return Err(format!("its data set {name:?} has chunks of {chunk} numbers, more than its file may take"));
        }
        let floats = || set.read_f64().map(Data::Floats).map_err(damaged);
        let data = match is_whole {
            // Integers beyond 63 bits are floats.
            true => set.read_i64().map(Data::Wholes).or_else(|_| floats())?,
            false => floats()?,
        };
        let sides = sides.into_iter().filter_map(|side| usize::try_from(side).ok()).collect();
        self.arrays.push(Array { name, sides, by_columns: false, data });
        Ok(())
    }
}
