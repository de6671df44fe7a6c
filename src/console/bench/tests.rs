//! The bench on the simulated rig, without a server.
