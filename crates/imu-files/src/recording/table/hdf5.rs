//! HDF5, and MATLAB's `.mat` of version 7.3, which is HDF5: the data sets of numbers in all groups. Pure.
//!
//! A data set is named by its path (`imu0/gyro_rad_s`). Read by the crate `hdf5-pure`, without C; groups are followed to a
//! depth of eight.

use super::arrays::{Array, Arrays, Data, most_bytes};
use hdf5_pure::{DType, File, Group};

const DEPTH_MAX: usize = 8;
/// Data sets that are looked at.
const SETS_MAX: usize = 1024;

/// Reads the data sets of a file.
///
/// # Errors
/// What was found and what would be right.
pub(super) fn read(bytes: &[u8]) -> Result<Arrays, String> {
    let damaged = |error: hdf5_pure::Error| format!("its HDF5 is damaged or was cut: {error}");
    let file = File::from_bytes(bytes.to_vec()).map_err(damaged)?;
    let mut arrays = Vec::new();
    let most = most_bytes(bytes.len());
    let mut left = most / size_of::<f64>();
    group(&file.root(), "", 0, &mut left, &mut arrays)
        .map_err(|what| what.unwrap_or_else(|| format!("its arrays take more than {most} bytes")))?;
    if arrays.is_empty() { Err("it has no data set of numbers".to_owned()) } else { Arrays::of(arrays) }
}

/// Reads the data sets of a group; an error without text if they are too large.
fn group(
    group: &Group,
    path: &str,
    depth: usize,
    left: &mut usize,
    arrays: &mut Vec<Array>,
) -> Result<(), Option<String>> {
    let damaged = |error: hdf5_pure::Error| Some(format!("its group {path:?} is damaged or was cut: {error}"));
    let called = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}/{name}") };
    for name in group.datasets().map_err(damaged)? {
        if arrays.len() >= SETS_MAX {
            return Ok(());
        }
        let set = group.dataset(&name).map_err(damaged)?;
        let name = called(&name);
        let damaged = |error: hdf5_pure::Error| Some(format!("its data set {name:?} is damaged or was cut: {error}"));
        let sides: Vec<usize> =
            set.shape().map_err(damaged)?.into_iter().filter_map(|side| usize::try_from(side).ok()).collect();
        let count = sides.iter().try_fold(1_usize, |all, side| all.checked_mul(*side));
        let kind = set.dtype().map_err(damaged)?;
        let is_float = matches!(kind, DType::F32 | DType::F64);
        let is_whole = matches!(
            kind,
            DType::I8 | DType::I16 | DType::I32 | DType::I64 | DType::U8 | DType::U16 | DType::U32 | DType::U64
        );
        if !is_float && !is_whole {
            continue;
        }
        *left = count.and_then(|count| left.checked_sub(count)).ok_or(None)?;
        let data = if is_float {
            Data::Floats(set.read_f64().map_err(damaged)?)
        } else {
            Data::Wholes(set.read_i64().map_err(damaged)?)
        };
        arrays.push(Array { name, sides, by_columns: false, data });
    }
    if depth < DEPTH_MAX {
        for name in group.groups().map_err(damaged)? {
            // MATLAB keeps what its cells refer to there.
            if name != "#refs#" {
                self::group(&group.group(&name).map_err(damaged)?, &called(&name), depth + 1, left, arrays)?;
            }
        }
    }
    Ok(())
}
