"""The unscented filter: sigma points carried through a vehicle's motion and measurements."""
