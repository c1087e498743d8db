//! Reads JSON text to a value and finds keys that occur twice in an object: `serde_json` itself keeps the last one.

use serde::de::{DeserializeSeed, Deserializer, Error as _, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};
use std::cell::RefCell;
use std::fmt;

/// A key that occurs twice in one object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Twice {
    /// The place of the second occurrence, such as `channels.gyro_x.N`.
    pub(super) path: String,
    /// The key.
    pub(super) key: String,
}

/// Returns the value of a text, or the first key that occurs twice in it.
///
/// # Errors
/// The error of a text that is not JSON.
pub(super) fn parse(text: &str) -> Result<Result<Value, Twice>, serde_json::Error> {
    let twice = RefCell::new(None);
    let mut reader = serde_json::Deserializer::from_str(text);
    let value = Node { path: String::new(), twice: &twice }.deserialize(&mut reader)?;
    reader.end()?;
    Ok(twice.into_inner().map_or(Ok(value), Err))
}

/// A value to be read, its place, and the record of a key that occurs twice.
struct Node<'a> {
    path: String,
    twice: &'a RefCell<Option<Twice>>,
}

impl<'de> DeserializeSeed<'de> for Node<'_> {
    type Value = Value;
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Node<'_> {
    type Value = Value;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("any JSON value")
    }
    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }
    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }
    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }
    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Value, E> {
        Number::from_f64(value).map(Value::Number).ok_or_else(|| E::custom("number out of range"))
    }
    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }
    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }
    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        let mut list = Vec::new();
        let item = |index: usize| Node { path: format!("{}[{index}]", self.path), twice: self.twice };
        while let Some(value) = items.next_element_seed(item(list.len()))? {
            list.push(value);
        }
        Ok(Value::Array(list))
    }
    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut map = Map::new();
        while let Some(key) = entries.next_key::<String>()? {
            let path = super::place::inside(&self.path, &key);
            if map.contains_key(&key) {
                let found = Twice { path: path.clone(), key: key.clone() };
                self.twice.try_borrow_mut().map_err(A::Error::custom)?.get_or_insert(found);
            }
            map.insert(key, entries.next_value_seed(Node { path, twice: self.twice })?);
        }
        Ok(Value::Object(map))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_key_that_stands_twice_is_named_with_its_place() {
        for (text, path, key) in [
            (r#"{"a":1,"a":1}"#, "a", "a"),
            (r#"{"a":[{"b":1},{"b":1,"c":{},"b":2}],"a":3}"#, "a[1].b", "b"),
            (r#"{"a":{"b":{"c":1,"\u0063":2}}}"#, "a.b.c", "c"),
        ] {
            assert_eq!(parse(text).unwrap(), Err(Twice { path: path.to_owned(), key: key.to_owned() }), "{text}");
        }
    }

    #[test]
    fn a_text_with_every_key_once_is_read_as_ever() {
        for text in [
            r#"{"a":[1,-2,3.5,1e-300,18446744073709551615,true,false,null,"ä\n",[],{}],"b":{"a":{"a":0.1}}}"#,
            "0.30000000000000004",
            "\"\"",
        ] {
            assert_eq!(parse(text).unwrap().unwrap(), serde_json::from_str::<Value>(text).unwrap());
        }
        for text in ["", "{", "[1,]", "{} {}", "1e400", &"[".repeat(1000)] {
            let (ours, known) = (parse(text).unwrap_err(), serde_json::from_str::<Value>(text).unwrap_err());
            assert_eq!(ours.to_string(), known.to_string(), "{text}");
        }
    }
}
