prt_test(screen SOURCES physics/screen.c LIBS prt_screen LABELS physics TIMEOUT 400)
