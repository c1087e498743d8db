//! Models: stored sensor models, as text. The crate `imu-model` interprets their content.

use super::sql::{find, value};
use super::{Page, PageRequest, Reader, Store, StoreError, UtcNs};
use rusqlite::{Row, params};
use serde::Serialize;

/// The maximum number of stored models.
pub const MODELS_MAX: u64 = 1000;

/// The properties of a sensor model.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ModelEntry {
    /// The id: `model-1`, `model-2`…
    pub id: String,
    /// The name.
    pub name: String,
    /// The output rate in Hz.
    pub rate_hz: f64,
    /// When it was stored.
    pub created_at: UtcNs,
}

/// A sensor model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelRow {
    /// Its properties.
    pub entry: ModelEntry,
    /// The model, JSON text.
    pub body: String,
}

pub(super) const HEAD: &str = "model_id, name, rate_hz, created_utc_ns";

pub(super) fn entry_of(row: &Row<'_>) -> rusqlite::Result<ModelEntry> {
    let id = called(row.get(0)?);
    Ok(ModelEntry { id, name: row.get(1)?, rate_hz: row.get(2)?, created_at: UtcNs(row.get(3)?) })
}

fn called(id: i64) -> String {
    format!("model-{id}")
}

fn model_of(row: &Row<'_>) -> rusqlite::Result<ModelRow> {
    Ok(ModelRow { entry: entry_of(row)?, body: row.get(4)? })
}

fn unknown(id: i64) -> StoreError {
    StoreError::NoSuchModel(called(id))
}

impl Store {
    /// Stores a model. Returns it, and whether it is new: the same text is the same model.
    ///
    /// # Errors
    /// [`StoreError::TooManyModels`], or the error that the database reports.
    pub fn keep_model(&self, name: &str, rate_hz: f64, body: String) -> Result<(ModelRow, bool), StoreError> {
        let (name, utc_ns) = (name.to_owned(), self.utc_ns());
        self.execute(move |transaction| {
            let sql = format!("SELECT {HEAD}, body FROM model WHERE body = ?1");
            if let Some(known) = find(transaction, &sql, [&body], model_of)? {
                return Ok((known, false));
            }
            let kept: i64 = value(transaction, "SELECT count(*) FROM model", [])?;
            if kept as u64 >= MODELS_MAX {
                return Err(StoreError::TooManyModels(MODELS_MAX));
            }
            let sql = "INSERT INTO model (name, rate_hz, created_utc_ns, body) VALUES (?1, ?2, ?3, ?4)";
            transaction.execute(sql, params![name, rate_hz, utc_ns, body])?;
            let id = called(transaction.last_insert_rowid());
            Ok((ModelRow { entry: ModelEntry { id, name, rate_hz, created_at: UtcNs(utc_ns) }, body }, true))
        })
    }

    /// Deletes a model. Jobs that were submitted with it hold it in their parameters and continue.
    ///
    /// # Errors
    /// [`StoreError::NoSuchModel`], or the error that the database reports.
    pub fn delete_model(&self, id: i64) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            let deleted = transaction.execute("DELETE FROM model WHERE model_id = ?1", [id])?;
            if deleted == 1 { Ok(()) } else { Err(unknown(id)) }
        })
    }
}

impl Reader {
    /// Returns a model.
    ///
    /// # Errors
    /// [`StoreError::NoSuchModel`], or the error that the database reports.
    pub fn model(&self, id: i64) -> Result<ModelRow, StoreError> {
        let sql = format!("SELECT {HEAD}, body FROM model WHERE model_id = ?1");
        find(&self.connection, &sql, [id], model_of)?.ok_or_else(|| unknown(id))
    }

    /// Returns the properties of the models, the latest first.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or the error that the database reports.
    pub fn models(&self, page: &PageRequest) -> Result<Page<ModelEntry>, StoreError> {
        let sql = format!("SELECT {HEAD} FROM model WHERE model_id < ?1 ORDER BY model_id DESC LIMIT ?2");
        let before = page.after("models")?.unwrap_or(i64::MAX);
        let values = params![before, page.limit() as i64 + 1];
        Page::read(&self.connection, &sql, values, page, "models", |row| Ok(entry_of(row)?))
    }
}

#[cfg(test)]
mod tests {
    use super::MODELS_MAX;
    use crate::store::tests::World;
    use crate::store::{PageRequest, StoreError};

    #[test]
    fn the_same_text_is_the_same_model_and_a_number_is_never_used_twice() {
        let world = World::new();
        let keep = |text: &str| world.store.keep_model("unit 7", 40.0, text.to_owned()).unwrap();
        let (one, other, again) = (keep("{}"), keep("[]"), keep("{}"));
        assert_eq!((&*one.0.entry.id, one.1, &*other.0.entry.id, other.1), ("model-1", true, "model-2", true));
        assert_eq!((again.0, again.1), (one.0.clone(), false));
        world.store.delete_model(2).unwrap();
        assert!(matches!(world.store.delete_model(2), Err(StoreError::NoSuchModel(_))));
        assert_eq!(keep("[]").0.entry.id, "model-3");
        let reader = world.reader();
        assert_eq!(reader.model(1).unwrap(), one.0);
        let page = reader.models(&PageRequest { limit: Some(1), cursor: None }).unwrap();
        assert_eq!(page.rows[0].id, "model-3");
        let rest = reader.models(&PageRequest { limit: None, cursor: page.next }).unwrap();
        assert_eq!((rest.rows.len(), &*rest.rows[0].id, rest.next), (1, "model-1", None));
    }

    #[test]
    fn one_too_many_is_refused_and_what_is_there_is_still_the_same() {
        let world = World::new();
        let keep = |number: u64| world.store.keep_model("unit", 40.0, number.to_string());
        for number in 0..MODELS_MAX {
            keep(number).unwrap();
        }
        let refused = keep(MODELS_MAX).unwrap_err();
        assert!(matches!(refused, StoreError::TooManyModels(MODELS_MAX)), "{refused}");
        assert!(!keep(7).unwrap().1);
        world.store.delete_model(1).unwrap();
        assert!(keep(MODELS_MAX).unwrap().1);
    }
}
