prt_test(room_store SOURCES unit/room_store.c LIBS relightd_rooms LABELS unit)
