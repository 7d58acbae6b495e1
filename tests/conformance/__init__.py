"""What every law must do."""
