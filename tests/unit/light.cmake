prt_test(light SOURCES unit/light.c LIBS prt_light prt_base LABELS unit)
