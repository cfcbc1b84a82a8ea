//! Writing new values into an edited file: what did not change keeps its place, its comments and its spelling.

use toml_edit::{Array, Item, Table, TableLike, Value};

/// Makes `old` say what `new` says.
pub fn merge(old: &mut Table, new: &Table) {
    merge_tables(old, new);
}

fn merge_tables(old: &mut dyn TableLike, new: &dyn TableLike) {
    let gone: Vec<String> = old.iter().map(|(key, _)| key.to_owned()).filter(|key| !new.contains_key(key)).collect();
    for key in gone {
        old.remove(&key);
    }
    for (key, item) in new.iter() {
        match old.get_mut(key) {
            Some(present) => merge_items(present, item),
            None => {
                old.insert(key, item.clone());
            }
        }
    }
}

fn merge_items(old: &mut Item, new: &Item) {
    // An array of tables may be spelt [[a]] or a = [{…}]: both are lists of tables.
    if let (Some(old), Some(new)) = (old.as_array_of_tables_mut(), new.as_array_of_tables()) {
        while old.len() > new.len() {
            old.remove(old.len() - 1);
        }
        for (i, table) in new.iter().enumerate() {
            match old.get_mut(i) {
                Some(present) => merge_tables(present, table),
                None => old.push(table.clone()),
            }
        }
        return;
    }
    if let (Some(_), Some(new)) = (old.as_table_like(), new.as_table_like()) {
        if let Some(old) = old.as_table_like_mut() {
            merge_tables(old, new);
        }
        return;
    }
    if let (Some(old), Some(new)) = (old.as_value_mut(), as_value(new)) {
        merge_values(old, new);
        return;
    }
    *old = new.clone();
}

/// An item as a value: arrays of tables become arrays of inline tables.
fn as_value(item: &Item) -> Option<Value> {
    item.clone().into_value().ok()
}

fn merge_values(old: &mut Value, mut new: Value) {
    if same(old, &new) {
        return;
    }
    *new.decor_mut() = old.decor().clone();
    *old = new;
}

/// Whether two values mean the same, however they are spelt (`1` is `1.0`).
fn same(a: &Value, b: &Value) -> bool {
    let number = |v: &Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    match (a, b) {
        (Value::String(a), Value::String(b)) => a.value() == b.value(),
        (Value::Boolean(a), Value::Boolean(b)) => a.value() == b.value(),
        (Value::Datetime(a), Value::Datetime(b)) => a.value() == b.value(),
        (Value::Array(a), Value::Array(b)) => same_arrays(a, b),
        (Value::InlineTable(a), Value::InlineTable(b)) => {
            a.len() == b.len() && a.iter().all(|(key, value)| b.get(key).is_some_and(|other| same(value, other)))
        }
        _ => number(a).is_some_and(|a| number(b) == Some(a)),
    }
}

fn same_arrays(a: &Array, b: &Array) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b))
}
