prt_test(trace SOURCES physics/trace.c physics/bodies.c LIBS prt_trace LABELS physics)
