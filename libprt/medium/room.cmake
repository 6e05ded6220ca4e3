# cJSON reads material files, expat MaterialX; LAPACKE and OpenBLAS give the radial bases.
pkg_check_modules(CJSON REQUIRED IMPORTED_TARGET libcjson)
find_library(PRT_OPENBLAS openblas REQUIRED)
find_library(LAPACKE_LIBRARY NAMES liblapacke.a lapacke REQUIRED) # as in bake/room.cmake
pkg_check_modules(EXPAT REQUIRED IMPORTED_TARGET expat)
target_link_libraries(prt_medium PUBLIC PkgConfig::CJSON ${LAPACKE_LIBRARY} ${PRT_OPENBLAS})
target_link_libraries(prt_medium PRIVATE PkgConfig::EXPAT)
