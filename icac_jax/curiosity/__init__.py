"""Maps, predictors and the intrinsic reward."""
