prt_test(physics_light SOURCES physics/light.c LIBS prt_light prt_base LABELS physics)
