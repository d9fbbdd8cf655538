"""The published way of evaluating a model: 21 XGBoost regressors, or a torch network in eager mode."""
