//! Soak: everything at once, for as long as asked, from a seed (row G).
