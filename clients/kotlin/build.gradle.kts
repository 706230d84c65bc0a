plugins {
    id("com.android.library")
    id("org.jetbrains.kotlin.android")
}

android {
    namespace = "roomfix"
    compileSdk = 34
    defaultConfig { minSdk = 24 }
}

dependencies {
    // For ContentPlacer alone.
    implementation("com.google.ar:core:1.44.0")
}
