mod config;
mod scene;
