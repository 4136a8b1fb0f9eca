"""Episodes to pictures: the only room that knows rerun."""
