prt_test(event_ring SOURCES unit/event_ring.c LIBS relightd_rooms LABELS unit)
