prt_test(object_store SOURCES unit/object_store.c LIBS relightd_rooms LABELS unit)
