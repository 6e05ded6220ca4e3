prt_test(screen SOURCES physics/screen.c physics/screen_stage.c physics/bodies.c LIBS prt_screen prt_reference
  LABELS physics)
