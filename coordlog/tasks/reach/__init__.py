"""The paper's task: bring every palm to its goal at the same step."""
