// Levels as data.

// The fields of a level that it is built from.
export function plain({ grid, agent, looks }) {
  return { grid, agent, looks };
}
