//! Names and notes of captures: which ones are valid, which name a new capture gets, and how both change later.

use super::error::{changed_one, no_such};
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
        let note = note.map(|note| check_note(&note)).transpose()?;
        let utc_ns = self.utc_ns();
        let progress = self.inner.progress.clone();
        let work = move |transaction: &Transaction<'_>| {
            let sql =
                "SELECT name, state IN ('waiting', 'capturing') FROM capture WHERE id = ?1 AND lifecycle = 'live'";
            let found = find(transaction, sql, [id], |row| Ok((row.get::<_, String>(0)?, row.get::<_, bool>(1)?)))?;
            let Some((old, is_open)) = found else { return Err(no_such(id)) };
            let name = name.filter(|name| *name != old);
            if let Some(name) = &name {
                // The present name stays allowed: it may be older than the rules.
                check_name(name)?;
                rename(transaction, id, &old, name, utc_ns)?;
            }
            if let Some(note) = note {
                transaction.execute("UPDATE capture SET note = ?2 WHERE id = ?1", params![id, note])?;
            }
            if let Some(pinned) = pinned {
                pin(transaction, id, pinned)?;
            }
            Ok(name.filter(|_| is_open))
        };
        // The status comes from memory: the writer sets it with the commit, so that the last of two names stays.
        let committed = move |renamed: &Option<String>| {
            if let Some(name) = renamed {
                super::progress::locked(&progress).renamed.insert(id, name.clone());
            }
        };
        self.execute_then(work, committed).map(drop)
    }

    /// Returns the name that a running capture was given since the start of this process.
    pub fn renamed(&self, id: i64) -> Option<String> {
        super::progress::locked(&self.inner.progress).renamed.get(&id).cloned()
    }
}

impl Reader {
    /// Returns the names that a capture had before it was renamed, each once.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn earlier_names(&self, id: i64) -> Result<Vec<String>, StoreError> {
        let sql = "SELECT DISTINCT detail ->> '$.from' FROM event WHERE capture_id = ?1 AND kind = ?2 \
                   AND detail ->> '$.from' IS NOT NULL ORDER BY 1";
        let mut statement = self.connection.prepare_cached(sql)?;
        let names = statement.query_map(params![id, EventKind::Renamed.name()], |row| row.get(0))?;
        Ok(names.collect::<Result<_, _>>()?)
    }

    /// Returns whether a capture that is shown has this name, or whether one that was made at this time (UTC, ns) or
    /// later had it before it was renamed.
    ///
    /// # Errors
    /// The error that the database reports.
    pub fn has_been_named(&self, name: &str, made_since_utc_ns: i64) -> Result<bool, StoreError> {
        let sql = "SELECT EXISTS (SELECT 1 FROM capture WHERE name = ?1 AND lifecycle = 'live') OR EXISTS \
                   (SELECT 1 FROM event JOIN capture ON capture.id = capture_id AND lifecycle = 'live' \
                   AND created_utc_ns >= ?3 WHERE kind = ?2 AND detail ->> '$.from' = ?1)";
        Ok(value(&self.connection, sql, params![name, EventKind::Renamed.name(), made_since_utc_ns])?)
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

/// Returns the id that a text means: digits alone, without a sign. A number above all ids means none that exists.
pub fn as_id(text: &str) -> Option<i64> {
    let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| text.parse().unwrap_or(i64::MAX))
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
    } else if as_id(name).is_some() {
        "a number means the capture with that id"
    } else if name.chars().count() > NAME_MAX {
        "it is longer than 100 characters"
    } else if name.chars().any(|character| character == '/' || is_hidden(character)) {
        "it holds a `/` or a control character"
    } else {
        return Ok(());
    };
    // An error is a line of text.
    let shown = name.chars().take(NAME_MAX).map(|one| if is_hidden(one) { ' ' } else { one }).collect();
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
    if note.chars().any(is_hidden) {
        return Err(StoreError::NoteRefused("it holds a line end or another control character: a note is one line"));
    }
    Ok(Some(note.to_owned()).filter(|note| !note.is_empty()))
}

/// Returns whether a character is not shown, and changes how others are: a control character, an end of a line or of a paragraph, or
/// one that turns the direction of writing (Unicode Bidirectional Algorithm, section 2), with which a text reads as another.
fn is_hidden(character: char) -> bool {
    character.is_control()
        || matches!(character, '\u{200e}' | '\u{200f}' | '\u{61c}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

/// Returns a text in one line without control characters, which a terminal would obey: those of a database or a daemon
/// may be anybody's.
pub fn printable(text: &str) -> String {
    if !text.contains(is_hidden) {
        return text.to_owned();
    }
    text.split(is_hidden).map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ")
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::tests::{World, a_capture};
    use crate::store::{CaptureState, NewCapture, PageRequest};

    #[test]
    fn a_liked_name_that_is_taken_gets_a_number() {
        let world = World::new();
        let liked = |name: &str| {
            let capture =
                NewCapture { liked_name: Some(name.to_owned()), ..NewCapture::new("x", CaptureState::Stopped) };
            world.reader().capture(world.store.create_capture(capture).unwrap()).unwrap().name
        };
        assert_eq!(["desk", "desk", "desk", "desk-2"].map(liked), ["desk", "desk-2", "desk-3", "desk-2-2"]);
        let long = "é".repeat(NAME_MAX);
        assert_eq!(liked(&long), long);
        assert_eq!(liked(&long), format!("{}-2", "é".repeat(NAME_MAX - 2)));
        let spaced = format!("{} x", "y".repeat(NAME_MAX - 2));
        assert_eq!([&spaced, &spaced].map(|name| liked(name))[1], format!("{}-2", "y".repeat(NAME_MAX - 2)));
        // The number of a deleted capture is free again.
        let second = world.reader().resolve("desk-2").unwrap();
        world.store.delete_capture(second).unwrap();
        assert_eq!(liked("desk"), "desk-2");
        assert!(liked("42").ends_with('Z'), "a number is no name");
    }

    #[test]
    fn a_character_that_turns_the_direction_of_writing_is_refused_and_not_printed() {
        let turned = "desk\u{202e}gpj.exe";
        assert!(check_name(turned).is_err() && check_note(turned).is_err());
        assert_eq!(printable(turned), "desk gpj.exe");
        assert_eq!(printable("on foam, 23 °C – مكتب"), "on foam, 23 °C – مكتب");
    }

    #[test]
    fn only_digits_mean_an_id() {
        let world = World::new();
        let ids = ["desk", "+1", "-1"].map(|name| world.complete(name));
        assert_eq!(ids, [1, 2, 3]);
        let found = |asked: &str| world.reader().resolve(asked).ok();
        assert_eq!(["1", "01", "+1", "-1", "latest"].map(found), [Some(1), Some(1), Some(2), Some(3), Some(3)]);
        for absent in ["", "+2", "-2", " 1", "1 ", "4", "99999999999999999999", "١"] {
            assert_eq!(found(absent), None, "{absent:?}");
        }
        for number in ["1", "01", "99999999999999999999"] {
            assert!(matches!(check_name(number), Err(StoreError::NameRefused { .. })), "{number}");
        }
    }

    #[test]
    fn name_note_and_protection_change_together_or_not_at_all() {
        let world = World::new();
        let note = Some(" on foam, 23 °C ".to_owned());
        let desk = NewCapture { note, name: Some("desk".to_owned()), ..NewCapture::new("x", CaptureState::Stopped) };
        let id = world.store.create_capture(desk).unwrap();
        let shelf = NewCapture { name: Some("shelf".to_owned()), ..NewCapture::new("x", CaptureState::Stopped) };
        world.store.create_capture(shelf).unwrap();
        let row = || world.reader().capture(id).unwrap();
        assert_eq!(row().note.as_deref(), Some("on foam, 23 °C"));
        let change = |name: Option<&str>, note: Option<&str>, pinned| {
            let (name, note) = (name.map(str::to_owned), note.map(str::to_owned));
            world.store.change_capture(id, CaptureChange { name, note, pinned })
        };
        let before = row();
        assert!(matches!(change(Some("shelf"), Some("other"), Some(true)), Err(StoreError::NameTaken(_))));
        assert!(matches!(change(Some("latest"), Some("other"), Some(true)), Err(StoreError::NameRefused { .. })));
        let long = "é".repeat(NOTE_MAX + 1);
        for refused in ["a\nb", "\u{1b}[31mred", &long] {
            assert!(
                matches!(change(Some("free"), Some(refused), Some(true)), Err(StoreError::NoteRefused(_))),
                "{refused}"
            );
        }
        assert_eq!(row(), before);
        change(Some("night"), Some(&long[2..]), Some(true)).unwrap();
        let changed = row();
        assert_eq!((changed.name.as_str(), changed.note.as_deref(), changed.pinned), ("night", Some(&long[2..]), true));
        // The same name is no event, and a name may be taken back.
        change(Some("night"), Some(" "), None).unwrap();
        assert_eq!((row().note, row().pinned), (None, true));
        change(Some("desk"), None, None).unwrap();
        let events = world.reader().events(id, &PageRequest::default()).unwrap().rows;
        let messages: Vec<&str> = events.iter().map(|event| event.message.as_str()).collect();
        assert_eq!(messages, ["capture `desk` was renamed to `night`", "capture `night` was renamed to `desk`"]);
        let reader = world.reader();
        assert_eq!(reader.earlier_names(id).unwrap(), ["desk", "night"]);
        let had = |name: &str, since: i64| reader.has_been_named(name, since).unwrap();
        assert!(["desk", "night", "shelf"].iter().all(|name| had(name, 0)) && !had("free", 0));
        // An earlier name counts only of a capture that was made since; a present one always.
        assert!(had("desk", i64::MAX) && !had("night", i64::MAX));
        let missing = world.store.change_capture(99, CaptureChange::default());
        assert!(matches!(missing, Err(StoreError::NoSuchCapture(_))));
    }

    #[test]
    fn of_renamings_at_once_the_status_has_the_last() {
        let world = World::new();
        let id = world.capturing();
        std::thread::scope(|scope| {
            for thread in 0..4 {
                let store = &world.store;
                scope.spawn(move || {
                    for number in 0..50 {
                        let name = Some(format!("{thread}-{number}"));
                        store.change_capture(id, CaptureChange { name, ..CaptureChange::default() }).unwrap();
                    }
                });
            }
        });
        assert_eq!(world.store.renamed(id), Some(world.reader().capture(id).unwrap().name));
    }

    #[test]
    fn a_name_that_is_older_than_the_rules_does_not_keep_a_note_out() {
        let world = World::new();
        let id = world.complete("desk");
        let old = "a/b";
        let sql = "UPDATE capture SET name = ?2 WHERE id = ?1";
        world.store.execute(move |transaction| Ok(transaction.execute(sql, params![id, old])?)).unwrap();
        let change = |name: &str, note: &str| {
            let (name, note) = (Some(name.to_owned()), Some(note.to_owned()));
            world.store.change_capture(id, CaptureChange { name, note, pinned: None })
        };
        change(old, "on foam").unwrap();
        assert!(matches!(change("c/d", "other"), Err(StoreError::NameRefused { .. })));
        let row = world.reader().capture(id).unwrap();
        assert_eq!((row.name.as_str(), row.note.as_deref()), (old, Some("on foam")));
    }

    #[test]
    fn a_recovered_capture_keeps_its_note() {
        let world = World::new();
        let id = world.capturing();
        world.send(id, a_capture());
        world.store.flush_blocking().unwrap();
        let note = Some("on foam, 23 °C".to_owned());
        world.store.change_capture(id, CaptureChange { note: note.clone(), ..CaptureChange::default() }).unwrap();
        let path = world.store.path().to_owned();
        world.store.close().unwrap();
        let out = world.directory.path().join("out.db");
        crate::store::recover(&path, &out, false).unwrap();
        assert_eq!(Reader::open(&out).unwrap().capture(id).unwrap().note, note);
        // What another program wrote is salvaged as a note, without control characters.
        let foreign = Connection::open(&path).unwrap();
        foreign.execute("UPDATE capture SET note = ?1", ["\u{1b}[2Jon\nfoam"]).unwrap();
        foreign.close().unwrap();
        crate::store::recover(&path, &out, true).unwrap();
        assert_eq!(Reader::open(&out).unwrap().capture(id).unwrap().note.as_deref(), Some("[2Jon foam"));
    }
}
