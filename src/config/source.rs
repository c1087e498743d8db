//! The text of a configuration file: maps keys to lines, and TOML's errors to those of this module.

use super::sections::Config;
use super::{ConfigError, Place};
use serde_json::Value;
use std::ops::Range;
use std::path::Path;
use toml::de::{DeTable, DeValue};

/// A file's name and text.
pub(super) struct Source<'a> {
    file: &'a Path,
    text: &'a str,
    /// Every key of the text with its section, its position and the position of its value.
    keys: Vec<(String, Range<usize>, Range<usize>)>,
}

impl<'a> Source<'a> {
    pub(super) fn new(file: &'a Path, text: &'a str) -> Self {
        let mut keys = Vec::new();
        if let Ok(table) = DeTable::parse(text) {
            collect("", table.get_ref(), &mut keys);
        }
        Self { file, text, keys }
    }

    /// Returns the typed configuration, not yet checked for ranges.
    pub(super) fn read(&self) -> Result<Config, ConfigError> {
        DeTable::parse(self.text).map_err(|error| ConfigError::Syntax {
            file: self.file.to_owned(),
            line: self.line(error.span().map_or(0, |span| span.start)),
            problem: error.message().replace('\n', ", "),
        })?;
        self.refuse_unknown()?;
        toml::from_str(self.text).map_err(|error| {
            let span = error.span().unwrap_or_default();
            // The innermost value around the error; an error of a whole section has the section's position.
            let (key, key_span, value) = self
                .keys
                .iter()
                .rev()
                .find(|(_, _, value)| value.start <= span.start && span.end <= value.end)
                .cloned()
                .unwrap_or_else(|| (String::new(), span.clone(), span.clone()));
            ConfigError::Value {
                place: Place::Line { file: self.file.to_owned(), line: self.line(key_span.start) },
                key,
                found: self.text.get(value).unwrap_or_default().to_owned(),
                allowed: error.message().trim().to_owned(),
            }
        })
    }

    /// Returns the position of the key, if the file has it.
    pub(super) fn place(&self, key: &str) -> Place {
        self.keys.iter().find(|(name, _, _)| name == key).map_or(Place::Default, |(_, span, _)| Place::Line {
            file: self.file.to_owned(),
            line: self.line(span.start),
        })
    }

    /// Refuses unknown keys with the names of that section's keys. The defaults, written out, are the list of all keys.
    fn refuse_unknown(&self) -> Result<(), ConfigError> {
        let known = serde_json::to_value(Config::default()).unwrap_or_default();
        for (key, span, _) in &self.keys {
            let mut here = &known;
            for part in key.split('.') {
                match (here, here.get(part)) {
                    (_, Some(inner)) => here = inner,
                    (Value::Object(section), None) => {
                        return Err(ConfigError::UnknownKey {
                            place: Place::Line { file: self.file.to_owned(), line: self.line(span.start) },
                            key: key.clone(),
                            allowed: section.keys().cloned().collect(),
                        });
                    }
                    // A table in place of a plain value: the typed reading reports it.
                    _ => break,
                }
            }
        }
        Ok(())
    }

    fn line(&self, offset: usize) -> usize {
        1 + self.text.bytes().take(offset).filter(|byte| *byte == b'\n').count()
    }
}

fn collect(prefix: &str, table: &DeTable<'_>, keys: &mut Vec<(String, Range<usize>, Range<usize>)>) {
    for (key, value) in table {
        let name = if prefix.is_empty() { key.get_ref().to_string() } else { format!("{prefix}.{}", key.get_ref()) };
        keys.push((name.clone(), key.span(), value.span()));
        if let DeValue::Table(inner) = value.get_ref() {
            collect(&name, inner, keys);
        }
    }
}
