BEGIN TRANSACTION;
CREATE TABLE api_keys (
	id VARCHAR(16) NOT NULL,
	name VARCHAR(80) NOT NULL,
	sha256 VARCHAR(64) NOT NULL,
	scopes VARCHAR(80) NOT NULL,
	created_at DATETIME NOT NULL,
	expires_at DATETIME NOT NULL,
	revoked_at DATETIME,
	PRIMARY KEY (id)
);
CREATE TABLE api_sessions (
	sha256 VARCHAR(64) NOT NULL,
	"key" VARCHAR(16) NOT NULL,
	expires_at DATETIME NOT NULL,
	PRIMARY KEY (sha256)
);
CREATE TABLE asset_diagnoses (
	diagnosis VARCHAR(32) NOT NULL,
	asset VARCHAR(128) NOT NULL,
	PRIMARY KEY (diagnosis),
	FOREIGN KEY(diagnosis) REFERENCES diagnoses (id),
	FOREIGN KEY(asset) REFERENCES assets (external_id)
);
CREATE TABLE asset_measurements (
	asset VARCHAR(128) NOT NULL,
	measurement VARCHAR(32) NOT NULL,
	PRIMARY KEY (asset, measurement),
	FOREIGN KEY(asset) REFERENCES assets (external_id),
	FOREIGN KEY(measurement) REFERENCES measurements (id)
);
CREATE TABLE assets (
	number INTEGER NOT NULL,
	external_id VARCHAR(128) NOT NULL,
	machine VARCHAR(200) NOT NULL,
	notes TEXT NOT NULL,
	baseline VARCHAR(32),
	created_at DATETIME NOT NULL,
	updated_at DATETIME NOT NULL,
	PRIMARY KEY (number),
	UNIQUE (external_id),
	FOREIGN KEY(baseline) REFERENCES measurements (id)
);
CREATE TABLE builds (
	number INTEGER NOT NULL,
	id VARCHAR(32) NOT NULL,
	created_at DATETIME NOT NULL,
	started_at DATETIME,
	ended_at DATETIME,
	machine JSON NOT NULL,
	"plan" JSON NOT NULL,
	plan_hash VARCHAR(64) NOT NULL,
	catalogue VARCHAR(255) NOT NULL,
	catalogue_id VARCHAR(64),
	workers INTEGER,
	state VARCHAR(16) NOT NULL,
	message TEXT NOT NULL,
	cases_done INTEGER NOT NULL,
	cases_total INTEGER NOT NULL,
	rate_per_s DOUBLE NOT NULL,
	seconds_left DOUBLE,
	attempts INTEGER NOT NULL,
	owner TEXT NOT NULL,
	lease_until DOUBLE NOT NULL,
	cancel_asked BOOLEAN NOT NULL,
	request_id VARCHAR(64),
	PRIMARY KEY (number),
	UNIQUE (id)
);
CREATE TABLE diagnoses (
	number INTEGER NOT NULL,
	id VARCHAR(32) NOT NULL,
	measurement VARCHAR(32) NOT NULL,
	catalogue VARCHAR(64) NOT NULL,
	machine JSON NOT NULL,
	created_at DATETIME NOT NULL,
	request JSON NOT NULL,
	result JSON NOT NULL,
	PRIMARY KEY (number),
	UNIQUE (id),
	FOREIGN KEY(measurement) REFERENCES measurements (id)
);
CREATE TABLE findings (
	number INTEGER NOT NULL,
	id VARCHAR(32) NOT NULL,
	diagnosis VARCHAR(32) NOT NULL,
	asset VARCHAR(128),
	created_at DATETIME NOT NULL,
	at DATETIME NOT NULL,
	joints JSON NOT NULL,
	text TEXT NOT NULL,
	PRIMARY KEY (number),
	UNIQUE (id),
	FOREIGN KEY(diagnosis) REFERENCES diagnoses (id)
);
CREATE TABLE idempotency (
	id VARCHAR(64) NOT NULL,
	fingerprint VARCHAR(64) NOT NULL,
	created_at DATETIME NOT NULL,
	status INTEGER,
	headers JSON NOT NULL,
	body BLOB NOT NULL,
	PRIMARY KEY (id)
);
CREATE TABLE measurements (
	number INTEGER NOT NULL,
	id VARCHAR(32) NOT NULL,
	sha256 VARCHAR(64) NOT NULL,
	name VARCHAR(255) NOT NULL,
	size_bytes BIGINT NOT NULL,
	said JSON NOT NULL,
	created_at DATETIME NOT NULL,
	summary JSON NOT NULL,
	PRIMARY KEY (number),
	UNIQUE (id)
);
CREATE TABLE service_revision (
	version_num VARCHAR(32) NOT NULL,
	CONSTRAINT service_revision_pkc PRIMARY KEY (version_num)
);
INSERT INTO "service_revision" VALUES('1');
CREATE TABLE webhook_deliveries (
	number INTEGER NOT NULL,
	id VARCHAR(32) NOT NULL,
	webhook VARCHAR(32) NOT NULL,
	event VARCHAR(64) NOT NULL,
	body TEXT NOT NULL,
	state VARCHAR(16) NOT NULL,
	attempts INTEGER NOT NULL,
	due_at DATETIME NOT NULL,
	error TEXT NOT NULL,
	created_at DATETIME NOT NULL,
	PRIMARY KEY (number),
	UNIQUE (id),
	FOREIGN KEY(webhook) REFERENCES webhooks (id) ON DELETE CASCADE
);
CREATE TABLE webhooks (
	number INTEGER NOT NULL,
	id VARCHAR(32) NOT NULL,
	url TEXT NOT NULL,
	events JSON NOT NULL,
	secret VARCHAR(64) NOT NULL,
	created_at DATETIME NOT NULL,
	PRIMARY KEY (number),
	UNIQUE (id)
);
CREATE INDEX ix_idempotency_created_at ON idempotency (created_at);
CREATE INDEX ix_builds_state ON builds (state);
CREATE INDEX ix_webhook_deliveries_state ON webhook_deliveries (state);
CREATE INDEX ix_webhook_deliveries_webhook ON webhook_deliveries (webhook);
CREATE INDEX ix_asset_diagnoses_asset ON asset_diagnoses (asset);
CREATE INDEX ix_findings_diagnosis ON findings (diagnosis);
CREATE INDEX ix_findings_asset ON findings (asset);
COMMIT;
