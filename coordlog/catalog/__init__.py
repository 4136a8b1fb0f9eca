"""Many episodes: what there is (index), which of it (query, select), and how two sets differ."""
