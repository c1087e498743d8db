//! Names and notes of captures: which ones are valid, which name a new capture gets, and how both change later.

use super::captures::{changed_one, no_such};
use super::insert::insert_event;
use super::sql::{find, value};
use super::{Reader, Store, StoreError};
use imu_core::sample::{EventKind, EventRecord};
use rusqlite::{Connection, Transaction, params};
use serde_json::json;

/// The longest name in characters.
pub const NAME_MAX: usize = 100;
/// The longest note in characters.
pub const NOTE_MAX: usize = 1000;

/// A change of a capture by a user; what is `None` stays.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CaptureChange {
    /// Its new name.
    pub name: Option<String>,
    /// Its new note; an empty one removes the note.
    pub note: Option<String>,
    /// Whether it is protected from deletion.
    pub pinned: Option<bool>,
}

impl Store {
    /// Changes a capture, wholly or not at all. A new name is an event of the capture.
    ///
    /// # Errors
    /// [`StoreError::NameRefused`], [`StoreError::NoteRefused`], [`StoreError::NameTaken`] if another capture has the
    /// name, [`StoreError::NoSuchCapture`], or the error that the database reports.
    pub fn change_capture(&self, id: i64, change: CaptureChange) -> Result<(), StoreError> {
        let CaptureChange { name, note, pinned } = change;
        if let Some(name) = &name {
            check_name(name)?;
        }
        let note = note.map(|note| check_note(&note)).transpose()?;
        let utc_ns = self.utc_ns();
        let renamed = self.execute(move |transaction| {
            let sql =
                "SELECT name, state IN ('waiting', 'capturing') FROM capture WHERE id = ?1 AND lifecycle = 'live'";
            let found = find(transaction, sql, [id], |row| Ok((row.get::<_, String>(0)?, row.get::<_, bool>(1)?)))?;
            let Some((old, is_open)) = found else { return Err(no_such(id)) };
            let name = name.filter(|name| *name != old);
            if let Some(name) = &name {
                rename(transaction, id, &old, name, utc_ns)?;
            }
            if let Some(note) = note {
                transaction.execute("UPDATE capture SET note = ?2 WHERE id = ?1", params![id, note])?;
            }
            if let Some(pinned) = pinned {
                pin(transaction, id, pinned)?;
            }
            Ok(name.filter(|_| is_open))
        })?;
        if let Some(name) = renamed {
            // The status comes from memory.
            super::progress::locked(&self.inner.progress).renamed.insert(id, name);
        }
        Ok(())
    }

    /// Returns the name that a running capture was given since the start of this process.
    pub fn renamed(&self, id: i64) -> Option<String> {
        super::progress::locked(&self.inner.progress).renamed.get(&id).cloned()
    }
}

impl Reader {
    /// Returns whether a capture that is shown has this name, or had it before it was renamed.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn has_been_named(&self, name: &str) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM capture WHERE name = ?1 AND lifecycle = 'live') OR EXISTS \
                   (SELECT 1 FROM event JOIN capture ON capture.id = capture_id AND lifecycle = 'live' \
                   WHERE kind = ?2 AND detail ->> '$.from' = ?1)";
        Ok(value(&self.connection, sql, params![name, EventKind::Renamed.name()])?)
    }
}

fn rename(transaction: &Transaction<'_>, id: i64, old: &str, name: &str, utc_ns: i64) -> Result<(), StoreError> {
    if !name_is_free(transaction, name)? {
        return Err(StoreError::NameTaken(name.to_owned()));
    }
    transaction.execute("UPDATE capture SET name = ?2 WHERE id = ?1", params![id, name])?;
    let event = EventRecord {
        utc_ns,
        kind: EventKind::Renamed,
        message: format!("capture `{old}` was renamed to `{name}`"),
        detail: Some(json!({ "from": old, "to": name })),
    };
    insert_event(transaction, id, &event)
}

pub(super) fn pin(transaction: &Transaction<'_>, id: i64, pinned: bool) -> Result<(), StoreError> {
    let sql = "UPDATE capture SET pinned = ?2, \
               deletion_said_utc_ns = CASE WHEN ?2 THEN NULL ELSE deletion_said_utc_ns END, \
               delete_at_utc_ns = CASE WHEN ?2 THEN NULL ELSE delete_at_utc_ns END \
               WHERE id = ?1 AND lifecycle = 'live'";
    changed_one(id, transaction.execute(sql, params![id, pinned])?)
}

/// Checks whether a capture may have this name.
///
/// # Errors
/// [`StoreError::NameRefused`] with the reason.
pub fn check_name(name: &str) -> Result<(), StoreError> {
    let why = if name.trim() != name || name.is_empty() {
        "it is empty or begins or ends with a space"
    } else if name == "latest" {
        "`latest` means the capture made last"
    } else if name.bytes().all(|byte| byte.is_ascii_digit()) {
        "a number means the capture with that id"
    } else if name.chars().count() > NAME_MAX {
        "it is longer than 100 characters"
    } else if name.chars().any(|character| character == '/' || character.is_control()) {
        "it holds a `/` or a control character"
    } else {
        return Ok(());
    };
    // An error is a line of text.
    let shown = name.chars().take(NAME_MAX).map(|one| if one.is_control() { ' ' } else { one }).collect();
    Err(StoreError::NameRefused { name: shown, why })
}

/// Returns the note as it is stored, without spaces at its ends; `None` if nothing is left.
///
/// # Errors
/// [`StoreError::NoteRefused`] with the reason.
pub fn check_note(note: &str) -> Result<Option<String>, StoreError> {
    let note = note.trim();
    if note.chars().count() > NOTE_MAX {
        return Err(StoreError::NoteRefused("it is longer than 1000 characters"));
    }
    if note.chars().any(char::is_control) {
        return Err(StoreError::NoteRefused("it holds a line end or another control character: a note is one line"));
    }
    Ok(Some(note.to_owned()).filter(|note| !note.is_empty()))
}

pub(super) fn name_is_free(connection: &Connection, name: &str) -> Result<bool, StoreError> {
    let sql = "SELECT NOT EXISTS (SELECT 1 FROM capture WHERE name = ?1 AND lifecycle = 'live')";
    Ok(value(connection, sql, [name])?)
}

/// Returns the name, or if a capture has it already the name with the lowest free number: `desk-2`, `desk-3`…; the end
/// of a long name gives way to the number.
pub(super) fn numbered(connection: &Connection, name: &str) -> Result<String, StoreError> {
    let (mut free, mut number) = (name.to_owned(), 2);
    while !name_is_free(connection, &free)? {
        let end = format!("-{number}");
        let begin: String = name.chars().take(NAME_MAX - end.len()).collect();
        free = format!("{}{end}", begin.trim_end());
        number += 1;
    }
    Ok(free)
}

/// Returns a free name made of the time, `2026-11-21T20-00-00Z`.
pub(super) fn free_name(connection: &Connection, utc_ns: i64) -> Result<String, StoreError> {
    numbered(connection, &chrono::DateTime::from_timestamp_nanos(utc_ns).format("%Y-%m-%dT%H-%M-%SZ").to_string())
}
