//! The serial line: unplugged, silent, garbled, at another baud rate (rows B1 to B8, B13, B16).
