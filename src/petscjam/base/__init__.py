"""What every folder uses: errors, types, files, progress, interrupts, compiled functions."""
