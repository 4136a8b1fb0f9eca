"""Keep every palm on a goal that moves slowly."""
