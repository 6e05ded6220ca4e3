prt_test(screen_tangent SOURCES physics/screen_tangent.c physics/screen_stage.c physics/bodies.c LIBS prt_screen prt_reference
  LABELS physics)
