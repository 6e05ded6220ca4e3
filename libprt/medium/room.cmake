# cJSON reads material files, expat MaterialX; LAPACKE and OpenBLAS give the radial bases.
pkg_check_modules(CJSON REQUIRED IMPORTED_TARGET libcjson)
pkg_check_modules(LAPACKE REQUIRED IMPORTED_TARGET lapacke openblas)
pkg_check_modules(EXPAT REQUIRED IMPORTED_TARGET expat)
target_link_libraries(prt_medium PUBLIC PkgConfig::CJSON PkgConfig::LAPACKE)
target_link_libraries(prt_medium PRIVATE PkgConfig::EXPAT)
