"""Studies of mice in mazes."""
