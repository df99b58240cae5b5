"""What `import bo_tuner` offers: studies of functions, ask and tell, results, certificates."""
