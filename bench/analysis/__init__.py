"""What a person looks at: metrics, figures, the report."""
