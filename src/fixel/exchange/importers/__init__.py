"""From recorded data to experiments: one reader a public dataset, and one for tables of your own."""
