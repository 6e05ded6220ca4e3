# Libraries of the texture room: libpng, libturbojpeg, libwebp.
pkg_check_modules(PNG REQUIRED IMPORTED_TARGET libpng)
pkg_check_modules(WEBP REQUIRED IMPORTED_TARGET libwebp)
pkg_check_modules(TURBOJPEG REQUIRED IMPORTED_TARGET libturbojpeg)
target_link_libraries(prt_texture PRIVATE PkgConfig::PNG PkgConfig::WEBP PkgConfig::TURBOJPEG)
