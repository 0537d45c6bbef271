"""Commands that say what there is: scenarios, estimators, keys, and the machine."""
