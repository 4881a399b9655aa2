"""Results, statistics, tables, pages, figures: what every report is made of."""
