#include "policy_server/server/config/config.h"

#include <algorithm>
#include <set>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/model/heartbeat.h"
#include "services/runtime/config_reader.h"

namespace rips::server {
namespace {

// An absolute path with a default; ReadPath is for those without.
void ReadOptionalPath(const ConfigSection& section, absl::string_view key, std::string* path) {
  section.Optional(key, path);
  if (path->front() != '/') {
    section.Problem(key, absl::StrCat("`", key, "` is `", *path, "`; write an absolute path"));
  }
}

void ReadAddress(const ConfigSection& section, absl::string_view key, std::string* address) {
  section.Optional(key, address);
  if (IsHostPort(*address)) return;
  section.Problem(key, absl::StrCat("`", key, "` is `", *address,
                                    "`; write `HOST:PORT`, for example `0.0.0.0:7443`"));
}

void ReadTrustDomain(const ConfigSection& root, std::string* domain) {
  constexpr size_t kBytesMax = 255;  // SPIFFE-ID §2.3
  root.Required("trust_domain", domain);
  if (domain->find_first_not_of("abcdefghijklmnopqrstuvwxyz0123456789.-_") != std::string::npos ||
      domain->size() > kBytesMax) {
    root.Problem("trust_domain",
                 absl::StrCat("`", *domain,
                              "` is not a trust domain; use at most 255 of a-z, "
                              "0-9, `.`, `-` and `_`, for example `fleet.example`"));
  }
}

void ReadTiming(const ConfigSection& root, Timing* timing) {
  const ConfigSection section = root.OptionalSection("timing");
  const auto read = [&](absl::string_view key, absl::Duration* value, absl::Duration min,
                        absl::Duration max) {
    section.Optional(key, value, {min, max});
  };
  read("heartbeat", &timing->heartbeat, absl::Nanoseconds(model::kHeartbeatNsMin),
       absl::Nanoseconds(model::kHeartbeatNsMax));
  read("stale", &timing->stale, absl::Milliseconds(100), absl::Minutes(1));
  read("lost", &timing->lost, absl::Milliseconds(200), absl::Minutes(5));
  read("lease", &timing->lease, absl::Milliseconds(500), absl::Minutes(10));
  read("drain_lease", &timing->drain_lease, absl::Milliseconds(500), absl::Hours(1));
  read("late_after", &timing->late_after, absl::Milliseconds(100), absl::Minutes(10));
  read("linger", &timing->linger, absl::ZeroDuration(), absl::Seconds(1));
  read("tick", &timing->tick, absl::Milliseconds(10), absl::Seconds(10));

  const std::pair<absl::string_view, absl::Duration> ascending[] = {
      {"heartbeat", timing->heartbeat},
      {"stale", timing->stale},
      {"lost", timing->lost},
      {"lease", timing->lease},
  };
  for (size_t i = 1; i < std::size(ascending); ++i) {
    const auto& [lower, shorter] = ascending[i - 1];
    const auto& [upper, longer] = ascending[i];
    if (shorter < longer) continue;
    section.Problem(upper, absl::StrCat("`", upper, "` (", FormatConfigDuration(longer),
                                        ") must be longer than `", lower, "` (",
                                        FormatConfigDuration(shorter), ")"));
  }
  if (timing->stale < 2 * timing->heartbeat) {
    section.Problem("stale", absl::StrCat("`stale` (", FormatConfigDuration(timing->stale),
                                          ") must be at least twice `heartbeat` (",
                                          FormatConfigDuration(timing->heartbeat),
                                          "): one late heartbeat would make every agent stale"));
  }
  if (timing->drain_lease < timing->lease) {
    section.Problem("drain_lease",
                    absl::StrCat("`drain_lease` (", FormatConfigDuration(timing->drain_lease),
                                 ") must not be shorter than `lease` (",
                                 FormatConfigDuration(timing->lease), ")"));
  }
}

void ReadShards(const ConfigSection& root, int* shards) {
  std::string text = "auto";
  root.Optional("shards", &text);
  if (text == "auto") return;
  if (text.find_first_not_of("0123456789") != std::string::npos ||
      !absl::SimpleAtoi(text, shards) || *shards < 1 || *shards > kShardsMax) {
    *shards = 0;
    root.Problem("shards", absl::StrCat("`shards` is `", text,
                                        "`; write `auto` or a number from 1 to ", kShardsMax));
  }
}

void ReadConnections(const ConfigSection& root, rpc::AdmissionLimits* limits) {
  const ConfigSection section = root.OptionalSection("connections");
  section.Optional("total", &limits->total, {16, 100'000});
  section.Optional("reserve", &limits->reserve, {0, 100'000});
  section.Optional("per_network", &limits->per_network, {1, 100'000});
  section.Optional("per_address", &limits->per_address, {1, 100'000});
  if (limits->reserve >= limits->total) {
    section.Problem("reserve", absl::StrCat("`reserve` (", limits->reserve,
                                            ") must be less than `total` (", limits->total, ")"));
  }
  limits->burst = limits->per_address;
}

void ReadFairness(const ConfigSection& root, Fairness* fairness) {
  const ConfigSection section = root.OptionalSection("fairness");
  section.Optional("cpu_per_second", &fairness->cpu_per_second,
                   {absl::Milliseconds(10), absl::Seconds(1)});
  section.Optional("cpu_burst", &fairness->cpu_burst, {absl::Milliseconds(10), absl::Seconds(10)});
  section.Optional("long_task", &fairness->long_task, {absl::Milliseconds(1), absl::Seconds(1)});
}

void ReadOperators(const ConfigSection& root, OperatorQuota* quota) {
  const ConfigSection section = root.OptionalSection("operators");
  section.Optional("streams", &quota->streams, {1, 256});
  section.Optional("calls", &quota->calls, {1, 1'000});
  section.Optional("calls_per_second", &quota->calls_per_second, {1, 10'000});
}

void ReadPlugins(const ConfigSection& root, ServerConfig* config) {
  const ConfigSection section = root.OptionalSection("plugins");
  section.Optional("user", &config->plugin_user);
  if (config->plugin_user == "root" || config->plugin_user == "0") {
    section.Problem("user",
                    "`user` is root; name a user that owns nothing, for example "
                    "`rips-plugin`");
  }
  section.Optional("readable", &config->plugin_readable);
  for (const std::string& path : config->plugin_readable) {
    if (path.empty() || path.front() != '/' || path == "/") {
      section.Problem("readable", absl::StrCat("`readable` has `", path,
                                               "`; write absolute paths of what plugins need"));
    }
  }
  section.Optional("helpers", &config->plugin_helpers);
  if (!config->plugin_helpers.empty() && config->plugin_helpers.front() != '/') {
    section.Problem("helpers", absl::StrCat("`helpers` is `", config->plugin_helpers,
                                            "`; write an absolute path"));
  }
}

void ReadBundles(const ConfigSection& root, ServerConfig* config) {
  const ConfigSection bundles = root.OptionalSection("bundles");
  ReadOptionalPath(bundles, "source", &config->bundles_source);
  ReadOptionalPath(bundles, "dir", &config->bundles_dir);
  bundles.Optional("keys", &config->bundle_keys);
  const std::vector<std::string>& keys = config->bundle_keys;
  if (keys.size() > kBundleKeysMax) {
    bundles.Problem("keys", absl::StrCat(keys.size(), " keys exceed limit ", kBundleKeysMax));
  }
  std::set<absl::string_view> seen;
  for (const std::string& path : keys) {
    if (path.empty() || path.front() != '/') {
      bundles.Problem("keys", absl::StrCat("`keys` has `", path,
                                           "`; write the absolute path of a public key, for "
                                           "example `/etc/rips/bundle-keys/alice.pem`"));
    }
    if (!seen.insert(path).second) {
      bundles.Problem("keys", absl::StrCat("key `", path, "` is listed twice"));
    }
  }
}

void ReadAlerts(const ConfigSection& root, ServerConfig* config) {
  const ConfigSection alerts = root.OptionalSection("alerts");
  ReadOptionalPath(alerts, "file", &config->alerts.path);
  // The least holds some lines of full length.
  constexpr ByteSize kLeast = {64 << 10};
  ByteSize rotate = {0};
  alerts.Optional("rotate_bytes", &rotate, {ByteSize{0}, ByteSize{int64_t{1} << 40}});
  if (rotate.bytes > 0 && rotate < kLeast) {
    alerts.Problem("rotate_bytes",
                   "`rotate_bytes` is less than 64KiB; write more, or `0B` to leave the rotation "
                   "to logrotate");
  }
  config->alerts.rotate_bytes = static_cast<uint64_t>(rotate.bytes);
  alerts.Optional("keep", &config->alerts.keep, {1, 100});
  if (alerts.Has("keep") && rotate.bytes == 0) {
    alerts.Problem("keep", "`keep` does nothing without `rotate_bytes`; write both or neither");
  }
}

void ReadAudit(const ConfigSection& root, ServerConfig* config) {
  if (!root.Has("audit")) return;
  const ConfigSection audit = root.OptionalSection("audit");
  config->audit_dir = "/var/lib/rips/policy-server/audit";
  ReadOptionalPath(audit, "dir", &config->audit_dir);
  ByteSize segment = {static_cast<int64_t>(config->audit_segment_bytes)};
  audit.Optional("segment", &segment, {ByteSize{64 << 10}, ByteSize{1 << 30}});
  config->audit_segment_bytes = static_cast<uint64_t>(segment.bytes);
}

void ReadExternalCa(const ConfigSection& enrolment, ExternalCaConfig* external) {
  const ConfigSection section = enrolment.RequiredSection("external_ca");
  section.Required("program", &external->program);
  const std::vector<std::string>& words = external->program;
  if (!words.empty() && (words[0].empty() || words[0].front() != '/')) {
    section.Problem("program", absl::StrCat("`program` begins with `", words[0],
                                            "`; write its absolute path, then its arguments"));
  }
  section.Optional("timeout", &external->timeout, {absl::Seconds(1), absl::Minutes(1)});
}

void ReadEnrolment(const ConfigSection& root, EnrolmentConfig* enrolment) {
  if (!root.Has("enrolment")) return;
  const ConfigSection section = root.OptionalSection("enrolment");
  const bool has_key = section.Has("cert") || section.Has("key");
  if (section.Has("external_ca")) {
    ReadExternalCa(section, &enrolment->external_ca);
    if (has_key) {
      section.Optional("cert", &enrolment->cert);
      section.Optional("key", &enrolment->key);
      section.Problem("external_ca",
                      "either `cert` and `key` sign certificates, or `external_ca` does; remove "
                      "one of both");
    }
  } else if (has_key) {
    ReadPath(section, "cert", &enrolment->cert);
    ReadPath(section, "key", &enrolment->key);
  } else {
    root.Problem("enrolment",
                 "`enrolment` needs `cert` and `key`, the issuing certificate and its key, or "
                 "`external_ca`");
  }
  section.Optional("life", &enrolment->life, {absl::Hours(6), 2 * absl::Hours(24 * 365)});
}

// Twice what one recording may have.
constexpr ByteSize kRecordingsMin = {8 << 20};

void ReadRecordings(const ConfigSection& root, ServerConfig* config) {
  const ConfigSection recordings = root.OptionalSection("recordings");
  // Of a store without an absolute path no second problem is made.
  const bool beside = config->store_path.front() == '/';
  config->recordings_dir = beside ? config->recordings_directory() : "/";
  ReadOptionalPath(recordings, "dir", &config->recordings_dir);
  ByteSize keep = {static_cast<int64_t>(config->recordings_bytes)};
  recordings.Optional("keep", &keep, {ByteSize{0}, ByteSize{int64_t{1} << 40}});
  if (keep.bytes > 0 && keep < kRecordingsMin) {
    recordings.Problem("keep",
                       "`keep` is less than 8MiB, so that few recordings would fit; write "
                       "more, or `0B` for none");
  }
  config->recordings_bytes = static_cast<uint64_t>(keep.bytes);
}

// URLs up to their host: what follows may be a token.
std::vector<ConfigSetting> WithoutPaths(std::vector<ConfigSetting> settings) {
  for (ConfigSetting& each : settings) {
    if (!absl::EndsWith(each.path, ".url")) continue;
    const size_t host = each.value.find("://");
    const size_t path = host == each.value.npos ? host : each.value.find_first_of("/?", host + 3);
    if (path != each.value.npos) each.value = absl::StrCat(each.value.substr(0, path), "/...");
  }
  return settings;
}

}  // namespace

std::string ServerConfig::recordings_directory() const {
  if (!recordings_dir.empty()) return recordings_dir;
  return absl::StrCat(store_path.substr(0, store_path.rfind('/')), "/recordings");
}

std::string ServerConfig::enrolment_path() const {
  return absl::StrCat(store_path.substr(0, store_path.rfind('/')), "/enrolment.db");
}

absl::StatusOr<ParsedServerConfig> ParseServerConfig(absl::string_view file,
                                                     absl::string_view text) {
  ConfigReader reader(file, text);
  const ConfigSection root = reader.root();
  ParsedServerConfig parsed;
  ServerConfig& config = parsed.config;
  ReadName(root, "id", "policy server id", &config.id);
  ReadAddress(root, "listen", &config.listen);
  ReadTrustDomain(root, &config.trust_domain);
  config.tls = ReadTls(root);
  ReadOptionalPath(root, "inventory", &config.inventory);
  ReadBundles(root, &config);
  const ConfigSection store = root.OptionalSection("store");
  enum class StoreKind { kSqlite } kind = StoreKind::kSqlite;
  store.OptionalEnum<StoreKind>("kind", &kind, {{"sqlite", StoreKind::kSqlite}});
  ReadOptionalPath(store, "path", &config.store_path);
  ReadAlerts(root, &config);
  config.outputs = ReadOutputs(root);
  ReadAudit(root, &config);
  ReadEnrolment(root, &config.enrolment);
  ReadRecordings(root, &config);
  ReadTiming(root, &config.timing);
  ReadConnections(root, &config.connections);
  ReadFairness(root, &config.fairness);
  ReadOperators(root, &config.operators);
  ReadShards(root, &config.shards);
  ReadPlugins(root, &config);
  ReadAddress(root, "metrics", &config.metrics);
  RIPS_RETURN_IF_ERROR(reader.Finish());
  parsed.settings = WithoutPaths(reader.Settings());
  return parsed;
}

}  // namespace rips::server
