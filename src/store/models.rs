//! Models: sensor models that were left here, as the text they are. What is in one is `simulator`'s affair.

use super::{Page, PageRequest, Reader, Store, StoreError, UtcNs};
use rusqlite::{OptionalExtension, Row, params};

/// A sensor model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelRow {
    /// Its number: the interface says `model-` before it.
    pub id: i64,
    /// Its name.
    pub name: String,
    /// Its output rate.
    pub rate_hz: f64,
    /// When it was left here.
    pub created_at: UtcNs,
    /// The model, JSON text.
    pub body: String,
}

const COLUMNS: &str = "model_id, name, rate_hz, created_utc_ns, body";

fn model_of(row: &Row<'_>) -> rusqlite::Result<ModelRow> {
    Ok(ModelRow {
        id: row.get(0)?,
        name: row.get(1)?,
        rate_hz: row.get(2)?,
        created_at: UtcNs(row.get(3)?),
        body: row.get(4)?,
    })
}

fn unknown(id: i64) -> StoreError {
    StoreError::NoSuchModel { asked: format!("model-{id}") }
}

impl Store {
    /// Keeps a model; answers it, and whether it is new: the same text is the same model.
    ///
    /// # Errors
    /// What the database says.
    pub fn keep_model(&self, name: &str, rate_hz: f64, body: String) -> Result<(ModelRow, bool), StoreError> {
        let (name, utc_ns) = (name.to_owned(), self.utc_ns());
        self.execute(move |transaction| {
            let sql = format!("SELECT {COLUMNS} FROM model WHERE body = ?1");
            if let Some(known) = transaction.query_row(&sql, [&body], model_of).optional()? {
                return Ok((known, false));
            }
            transaction.execute(
                "INSERT INTO model (name, rate_hz, created_utc_ns, body) VALUES (?1, ?2, ?3, ?4)",
                params![name, rate_hz, utc_ns, body],
            )?;
            let id = transaction.last_insert_rowid();
            Ok((ModelRow { id, name, rate_hz, created_at: UtcNs(utc_ns), body }, true))
        })
    }

    /// Deletes a model. Jobs that were submitted with it have it in their parameters and go on.
    ///
    /// # Errors
    /// [`StoreError::NoSuchModel`], or what the database says.
    pub fn delete_model(&self, id: i64) -> Result<(), StoreError> {
        self.execute(move |transaction| {
            let deleted = transaction.execute("DELETE FROM model WHERE model_id = ?1", [id])?;
            if deleted == 1 { Ok(()) } else { Err(unknown(id)) }
        })
    }
}

impl Reader {
    /// One model.
    ///
    /// # Errors
    /// [`StoreError::NoSuchModel`], or what the database says.
    pub fn model(&self, id: i64) -> Result<ModelRow, StoreError> {
        let sql = format!("SELECT {COLUMNS} FROM model WHERE model_id = ?1");
        self.connection.prepare_cached(&sql)?.query_row([id], model_of).optional()?.ok_or_else(|| unknown(id))
    }

    /// Models, the latest first.
    ///
    /// # Errors
    /// [`StoreError::BadCursor`], or what the database says.
    pub fn models(&self, page: &PageRequest) -> Result<Page<ModelRow>, StoreError> {
        let sql = format!("SELECT {COLUMNS} FROM model WHERE model_id < ?1 ORDER BY model_id DESC LIMIT ?2");
        let before = page.after("models")?.unwrap_or(i64::MAX);
        let mut statement = self.connection.prepare_cached(&sql)?;
        let rows = statement.query_map(params![before, page.limit() as i64 + 1], model_of)?;
        let rows = rows.map(|row| row.map(|row| (row.id, row))).collect::<Result<Vec<_>, _>>()?;
        Ok(Page::cut(rows, page.limit(), "models"))
    }
}

#[cfg(test)]
mod tests {
    use crate::store::tests::World;
    use crate::store::{PageRequest, StoreError};

    #[test]
    fn the_same_text_is_the_same_model_and_a_number_is_never_used_twice() {
        let world = World::new();
        let keep = |text: &str| world.store.keep_model("unit 7", 40.0, text.to_owned()).unwrap();
        let (one, other, again) = (keep("{}"), keep("[]"), keep("{}"));
        assert_eq!((one.0.id, one.1, other.0.id, other.1), (1, true, 2, true));
        assert_eq!((again.0, again.1), (one.0.clone(), false));
        world.store.delete_model(2).unwrap();
        assert!(matches!(world.store.delete_model(2), Err(StoreError::NoSuchModel { .. })));
        assert_eq!(keep("[]").0.id, 3);
        let reader = world.reader();
        assert_eq!(reader.model(1).unwrap(), one.0);
        let page = reader.models(&PageRequest { limit: Some(1), cursor: None }).unwrap();
        assert_eq!(page.rows[0].id, 3);
        let rest = reader.models(&PageRequest { limit: None, cursor: page.next }).unwrap();
        assert_eq!((rest.rows.len(), rest.rows[0].id, rest.next), (1, 1, None));
    }
}
