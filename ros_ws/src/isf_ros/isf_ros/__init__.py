"""ROS plumbing shared by the nodes: conversion, QoS, lifecycle base, stamps, watchdog, background work."""
