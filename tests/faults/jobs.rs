//! Background work that is interrupted, starved or fed nonsense (rows F1 to F7).
