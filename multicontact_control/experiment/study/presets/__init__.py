"""What kinds of studies have beside their file: findings, figures, jobs of their own."""
